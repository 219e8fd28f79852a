/* Travel of one stage axis (STAGE_MOVE, STAGE_STOP): from where to where, since when, and its settling. */
#include "core.h"

#define SPEED_FIELD 2   /* of STAGE_MOVE and PATH_MOVE */
#define SETTLE_TICKS 50 /* from the end of the travel until the stage is at rest */

/* Takes over where the stages stand. */
void stages_look(struct edm_controller *c) {
    for (uint8_t axis = AXIS_X; axis <= (uint8_t)AXIS_THETA; axis++) {
        c->stages.at[axis] = hal_stage_place(c->board, axis, c->stages.at[axis]);
    }
}

/* Refuses a speed that an axis cannot do, with what it can; what float rounds is not looked at. */
uint8_t stages_judge_speed(struct edm_controller *c, uint8_t axis, real speed) {
    real most_speed = hal_stage_speed_max(c->board, axis);
    if (!(speed > R(1.000001) * most_speed)) {
        return STATUS_OK;
    }
    uint8_t *p = c->link.reply.payload; /* index of the field, then least and greatest value of the wire (Status of a reply) */
    p[0] = SPEED_FIELD;
    put_u64(p + 1, 1);
    put_u64(p + 9, (uint64_t)nearest(most_speed * R(1000.0)));
    c->link.reply.size = 17;
    return STATUS_OUT_OF_RANGE;
}

/* Lets an axis travel (µm and µm/s, degrees and degrees/s) and come to rest. */
void stages_start(struct edm_controller *c, uint8_t axis, real target, real speed) {
    struct edm_stages *s = &c->stages;
    s->travels = true;
    s->axis = axis;
    s->start = s->at[axis];
    s->target = target;
    s->start_tick = c->tick;
    s->travel_ticks = ceiling_of(magnitude(target - s->start) / speed / TICK_S);
    hal_stage_start(c->board, axis, target, speed);
}

/* The tick at which the stage has come to rest by its speed; NEVER where none travels. */
static int64_t arrival_tick(const struct edm_stages *s) {
    return s->travels ? s->start_tick + s->travel_ticks + SETTLE_TICKS : NEVER;
}

/* Whether a stage that travels should be at rest by now. */
bool stages_arrived(const struct edm_controller *c) {
    return c->tick >= arrival_tick(&c->stages);
}

/* Ends the travel where the stage is now: by its speed, or where the board says. */
void stages_stop(struct edm_controller *c) {
    struct edm_stages *s = &c->stages;
    if (!s->travels) {
        return;
    }
    s->travels = false;
    real share = (real)(c->tick - s->start_tick) / (real)(s->travel_ticks > 1 ? s->travel_ticks : 1);
    s->at[s->axis] = s->start + least(R(1.0), share) * (s->target - s->start);
    hal_stage_stop(c->board, s->axis, s->at[s->axis]);
    stages_look(c);
}

int64_t edm_next_deadline(const struct edm_controller *c) {
    int64_t next = c->events.repeat_tick;
    int64_t others[] = {watchdog_tick(c), arrival_tick(&c->stages)};
    for (int i = 0; i < 2; i++) {
        next = others[i] < next ? others[i] : next;
    }
    return next;
}
