/* The controller in the caller's memory, over the records of the plant and those that edmctl/core/library.py declares. */
#ifndef EDM_HOST_H
#define EDM_HOST_H

#include "../edm.h"
#include "../plant/plant.h"
#include "host_records.h"

#define OUT_BYTES 262144 /* 256 KiB */

/* library.Callbacks: what only the machine's model can do; none is called within a tick. */
struct host_callbacks {
    double (*set_generator)(double on_us, double off_us, double open_v, double peak_a, double discharge_us);
    void (*stage_stop)(int64_t axis, double at);
    void (*path_begin)(void);
    void (*path_line)(int64_t row);
    void (*path_end)(void);
    int64_t (*wave_memory)(void);
    void (*wave_keep)(void);
    void (*wave_forget)(int64_t kept);
    void (*wave_read)(int64_t offset, int64_t samples, int16_t *counts);
    void (*follow)(int64_t look);
    int64_t (*due)(void);
};

struct edm_host {
    struct edm_controller core;
    struct inputs inputs; /* written by the caller before edm_host_receive, edm_host_watch and edm_host_create */
    struct seen seen;
    struct drive *drive;
    const struct readings *readings;
    struct host_callbacks callbacks;
    bool urgent; /* something was sent that the host answers */
    bool follows_path;
    int64_t samples_state; /* state at the end of the newest TLM frame */
    int64_t judged_tick;   /* when its calm was judged last */
    int64_t pulses[4];     /* by class, since then */
    uint8_t last_samples[FRAME_MOST]; /* the newest TLM frame */
    size_t merged_at; /* in `samples`, of what more can be appended to */
    _Alignas(8) uint8_t samples[SAMPLES_BYTES];
    uint8_t out[OUT_BYTES];
};

void edm_host_begin(struct edm_host *h);
void edm_host_conclude(struct edm_host *h, int64_t happened);
void edm_host_watch(struct edm_host *h);
int64_t edm_host_slice_end(const struct edm_host *h);
bool host_samples_are_urgent(struct edm_host *h);
bool host_merge_samples(struct edm_host *h, const uint8_t *frame, size_t size);
int64_t edm_host_end(struct edm_host *h);

#endif
