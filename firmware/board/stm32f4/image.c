/* What others find in the image: its description for who flashes it, places in the controller's memory for tests. */
#include "../../core/version.h"
#include "board.h"

#define CONTROLLER(member) offsetof(struct edm_controller, member)

extern const uint8_t image_size[]; /* its address is the size (f429.ld) */

/* `crc` is the CRC-32 of the image's bytes with 0 in its place; who builds the image puts it there. */
__attribute__((section(".image"), used)) const struct {
    char magic[4];
    uint8_t proto_major, proto_minor;
    uint16_t board;
    uint32_t schema_hash;
    uint8_t firmware[4]; /* major, minor, patch, 0 */
    const uint8_t *size;
    uint32_t crc;
} edm_image = {
    {'E', 'D', 'M', 'I'}, PROTO_MAJOR, PROTO_MINOR, BOARD_NUMBER, SCHEMA_HASH, {FW_MAJOR, FW_MINOR, FW_PATCH, 0}, image_size, 0,
};

/* What tells this image from others. */
uint32_t image_check(void) {
    return *(const volatile uint32_t *)&edm_image.crc;
}

/* What was set in the image by its owner: names and values, set by who builds it. */
#ifndef EDM_SETTINGS
#define EDM_SETTINGS ""
#endif
__attribute__((section(".image.settings"), used)) const char edm_settings[] = "EDMS" EDM_SETTINGS;

__attribute__((section(".image.layout"), used)) const uint32_t edm_layout[] = {
    CONTROLLER(tick),
    CONTROLLER(boot_tick),
    CONTROLLER(state),
    CONTROLLER(armed),
    CONTROLLER(keeps.fault),
    CONTROLLER(keeps.boot_count),
    CONTROLLER(box.frozen),
    CONTROLLER(box.frozen_tick),
    CONTROLLER(settings.watchdog_ticks),
    CONTROLLER(parameters.crc),
    CONTROLLER(motion.mode),
    CONTROLLER(gap.tick),
    CONTROLLER(gap.pulse_no),
    CONTROLLER(motion.command_v),
    CONTROLLER(gap.displacement_um),
    CONTROLLER(gap.gap_v),
    CONTROLLER(receiver.bad),
    CONTROLLER(link.drop),
    CONTROLLER(link.frames),
    CONTROLLER(arms),
    CONTROLLER(touch_offs),
    CONTROLLER(readings),
    sizeof(struct edm_controller),
    CONTROLLER(keeps.event_no),
    CONTROLLER(telemetry.counter),
    CONTROLLER(telemetry.pulse_counter),
};
