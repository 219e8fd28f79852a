/* SCAN_START and PATH_MOVE: stages and limit follow a queue of lines (docs/protocol.md, Scanning). */
#include "core.h"

/* Hands the stages over to the path, from where they stand. */
void scan_begin(struct edm_controller *c) {
    struct edm_scan *scan = &c->scan;
    scan->scanning = scan->follows = true;
    scan->count = 0;
    scan->path_ends = false;
    memset(scan->rest_um, 0, sizeof scan->rest_um);
    stages_look(c);
    c->drive.stage_um[AXIS_X] = c->stages.at[AXIS_X];
    c->drive.stage_um[AXIS_Y] = c->stages.at[AXIS_Y];
    hal_path_begin(c->board);
}

/* Appends a line; false where the queue is full. */
bool scan_append(struct edm_controller *c, const struct edm_line *line) {
    struct edm_scan *scan = &c->scan;
    if (scan->count == EDM_PATH_LINES) {
        return false;
    }
    uint8_t row = (uint8_t)((scan->at + scan->count) % EDM_PATH_LINES);
    scan->lines[row] = *line;
    hal_path_line(c->board, row);
    scan->count++;
    scan->path_ends = line->last;
    return true;
}

/* Whatever ends a scan empties the queue. */
void scan_end(struct edm_controller *c) {
    c->scan.scanning = false;
    c->scan.count = 0;
    scan_release(c);
}

/* Takes the stages back from a scan that has ended. */
void scan_release(struct edm_controller *c) {
    if (c->scan.follows && !c->scan.scanning) {
        c->scan.follows = false;
        hal_path_end(c->board);
        stages_look(c);
    }
}

/* Square root: one instruction where -fno-math-errno is given, and exact everywhere. */
static real root_of(real square) {
#ifdef EDM_REAL_DOUBLE
    return __builtin_sqrt(square);
#else
    return __builtin_sqrtf(square);
#endif
}

static void move_to(struct edm_controller *c, real x_um, real y_um) {
    c->drive.stage_um[AXIS_X] = c->stages.at[AXIS_X] = x_um;
    c->drive.stage_um[AXIS_Y] = c->stages.at[AXIS_Y] = y_um;
}

/* Whether the stages have come where the path has brought them. */
static bool stages_there(const struct edm_controller *c) {
    for (uint8_t axis = AXIS_X; axis <= (uint8_t)AXIS_Y; axis++) {
        real wanted = c->drive.stage_um[axis];
        real place = hal_stage_place(c->board, axis, wanted);
        if (place < wanted || place > wanted) {
            return false;
        }
    }
    return true;
}

/* Moves the stages by one millisecond along the path, and the limit with them. Nothing moves while the gap is shorted, in a
 * jump, or while the stages have not come after. */
int scan_tick(struct edm_controller *c) {
    struct edm_scan *scan = &c->scan;
    struct edm_drive *drive = &c->drive;
    if (c->motion.mode != SERVO || c->gap.shorted || scan->count == 0 || !stages_there(c)) {
        return NOTHING;
    }
    drive->stage_moves = 1;
    drive->stage_line = scan->at;
    drive->stage_lines_done = 0;
    drive->stage_share = drive->stage_way_um = 0;
    real left_s = TICK_S;
    while (scan->count > 0 && left_s > 0) {
        const struct edm_line *line = &scan->lines[scan->at];
        real x = line->x_um - drive->stage_um[AXIS_X];
        real y = line->y_um - drive->stage_um[AXIS_Y];
        real way = root_of(x * x + y * y);
        real needed_s = way / line->speed_um_s;
        if (needed_s > left_s) {
            real share = left_s / needed_s;
            move_to(c, added(drive->stage_um[AXIS_X], share * x, &scan->rest_um[0]),
                    added(drive->stage_um[AXIS_Y], share * y, &scan->rest_um[1]));
            c->servo.z_limit_um =
                added(c->servo.z_limit_um, share * (line->z_um - c->servo.z_limit_um), &scan->rest_um[2]);
            drive->stage_share = share;
            drive->stage_way_um += share * way;
            return NOTHING;
        }
        left_s -= needed_s;
        move_to(c, line->x_um, line->y_um);
        c->servo.z_limit_um = line->z_um;
        memset(scan->rest_um, 0, sizeof scan->rest_um);
        drive->stage_way_um += way;
        if (line->last && !stages_there(c)) {
            return NOTHING; /* the line stays until they are at its end */
        }
        drive->stage_lines_done++;
        scan->at = (uint8_t)((scan->at + 1) % EDM_PATH_LINES);
        scan->count--;
        if (line->last) {
            return motion_end(c, PATH_IS_DONE);
        }
    }
    return NOTHING;
}
