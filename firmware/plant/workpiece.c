/* Cells of the work under a tool: what sinks with its face, and what becomes of them (edmctl/simulator/work_under_tool.py). */
#include "plant.h"

#include "../math/elementary.h"
#include <stdlib.h>

#define PI 3.141592653589793

/* Fill effective depths (infinite where the sheet is gone), weights and what is under the face; returns the level.
 *
 * x, y, radius and reach are in cells, from the centre of the first cell on. The effective depth of a cell is its depth
 * and how far the rounded tip lies back there. A cell counts by the share of it that the disc covers, adjusted so that
 * the disc has its exact area; under the face it counts whole. */
double edm_work_look(const struct cells *f, double x, double y, double radius, double reach, double rounding_um,
                     double gone_um) {
    double total = 0.0, partial = 0.0, level_um = INFINITE;
    for (int64_t i = 0; i < f->size; i++) {
        for (int64_t j = 0; j < f->size; j++) {
            int64_t at = i * f->size + j;
            double across = (double)j - x, down = (double)i - y, away = edm_sqrt(across * across + down * down);
            double covered = lesser(1.0, greater(0.0, 0.5 + reach - away));
            f->under[at] = away <= radius ? 1.0 : 0.0;
            double weight = greater(covered, f->under[at]);
            f->weights[at] = weight;
            f->effective[at] = INFINITE;
            total += weight;
            partial += weight * (1.0 - weight);
            if (weight > 0.0 && f->cells[at] < f->thickness_um - gone_um) {
                double back = lesser(1.0, away / radius);
                f->effective[at] = f->cells[at] + rounding_um * back * back;
                if (f->under[at] == 1.0) {
                    level_um = lesser(level_um, f->effective[at]);
                }
            }
        }
    }
    double missing = PI * reach * reach - total;
    double stretch = partial > 0.0 ? lesser(1.0, greater(-1.0, missing / partial)) : 0.0;
    for (int64_t at = 0; at < f->size * f->size; at++) {
        /* A weight stays below one: no cell of the rim gets deeper than the floor. */
        f->weights[at] += stretch * f->weights[at] * (1.0 - f->weights[at]);
    }
    return level_um;
}

/* A cell joins what sinks, or falls out of the sheet, at a level. */
struct event {
    double level_um, weight; /* negative where it falls */
    int64_t order, fall;     /* fall: 1 of a cell beside the face, 2 under it */
};

static int compare(const void *a, const void *b) {
    const struct event *left = a, *right = b;
    if (left->level_um != right->level_um) {
        return left->level_um < right->level_um ? -1 : 1;
    }
    return left->order < right->order ? -1 : 1;
}

/* What sinks, and what is left of it and of the face. */
struct sinking {
    double weight, whole;
    int64_t cells, cells_left, face, face_left;
    bool is_whole; /* nothing has fallen out under the face: all cells that are left sink as one disc */
};

static struct sinking counted(const struct cells *f, double level_um) {
    struct sinking s = {0};
    for (int64_t at = 0; at < f->size * f->size; at++) {
        s.whole += f->weights[at];
        s.face += (int64_t)f->under[at];
        if (f->effective[at] < INFINITE) {
            s.cells_left++;
            s.face_left += (int64_t)f->under[at];
            if (f->effective[at] <= level_um) {
                s.weight += f->weights[at];
                s.cells++;
            }
        }
    }
    s.is_whole = s.face_left == s.face;
    return s;
}

static int64_t listed(const struct cells *f, double level_um, struct event *events) {
    int64_t n = 0;
    for (int64_t at = 0; at < f->size * f->size; at++) {
        double effective_um = f->effective[at];
        if (effective_um == INFINITE) {
            continue;
        }
        if (effective_um > level_um) {
            events[n] = (struct event){effective_um, f->weights[at], n, 0};
            n++;
        }
        if (f->thickness_um < INFINITE) {
            double falls_um = f->thickness_um + (effective_um - f->cells[at]);
            events[n] = (struct event){falls_um, -f->weights[at], n, 1 + (int64_t)f->under[at]};
            n++;
        }
    }
    return n;
}

static double share_of(const struct sinking *s) {
    if (s->is_whole && s->cells == s->cells_left) {
        return 1.0;
    }
    return s->cells > 0 ? s->weight / s->whole : 0.0;
}

static double rarity_of(const struct sinking *s) {
    return s->face_left > 0 ? (double)s->face / (double)s->face_left : INFINITE;
}

/* Write the table of a footprint, three rows of `width`: levels, sinking share and rarity of ignition from there on.
 * Returns the columns used; `now` gets share and rarity at the level. `room` has 4 * size * size * 2 doubles.
 * Cells join what sinks at their effective depth, and fall out of a sheet one thickness below its face. */
int64_t edm_work_tabulate(const struct cells *f, double level_um, double *table, int64_t width, double *now,
                          void *room) {
    double *levels_um = table, *share = table + width, *rarity = table + 2 * width;
    struct sinking s = counted(f, level_um);
    int64_t columns = 0;
    now[0] = s.face_left == 0 ? 1.0 : share_of(&s);
    now[1] = rarity_of(&s);
    if (s.face_left > 0) {
        struct event *events = room;
        int64_t n = listed(f, level_um, events);
        qsort(events, (size_t)n, sizeof *events, compare);
        for (int64_t k = 0; k < n; k++) {
            s.weight += events[k].weight;
            if (events[k].fall == 0) {
                s.cells++;
            } else {
                s.cells--;
                s.is_whole = false;
                s.face_left -= events[k].fall - 1;
            }
            if (k + 1 < n && events[k + 1].level_um == events[k].level_um) {
                continue;
            }
            levels_um[columns] = events[k].level_um;
            share[columns] = share_of(&s);
            rarity[columns] = rarity_of(&s);
            columns++;
        }
    }
    levels_um[columns] = INFINITE;
    share[columns] = rarity[columns] = 1.0;
    return columns + 1;
}

/* Lower the cells by what the level sank: those deeper than it from where it met them, those above with it. */
void edm_work_sink(const struct cells *f, double before_um, double after_um) {
    for (int64_t at = 0; at < f->size * f->size; at++) {
        double effective_um = f->effective[at], weight = f->weights[at];
        if (weight == 0.0 || effective_um >= after_um) {
            continue;
        }
        double depth_um = f->cells[at] + weight * (after_um - greater(effective_um, before_um));
        if (weight == 1.0 && effective_um >= before_um) {
            depth_um = after_um - (effective_um - f->cells[at]); /* exactly the level where the tip is flat */
        }
        f->cells[at] = lesser(depth_um, f->thickness_um);
    }
}
