/* Rows of a player's table that end early; src/panda_cosim/run/guarded.py explains them. */
#ifndef PLAYER_GUARD_H
#define PLAYER_GUARD_H

#include "backend.h"

enum { BASE_FROM = 60, BASE_TO = 160, AVERAGED = 10 }; /* ticks, as in guarded.py */
#define STEP 0.001   /* [s] */
#define BRAKING 0.02 /* [s] in which the hand stops */

/* A row that may end early, as the resource `guards` holds it. */
typedef struct {
    double first, last; /* ticks at which the hand leaves the row before, and of the row's time */
    double element;     /* 0: contact; 1 to 6: of the external force; 7: its length */
    double bound, way[3];
} player_guard;

/* What the next step depends on. */
typedef struct {
    int64_t ahead;         /* ticks by which the table is ahead */
    int64_t ended;         /* tick of the last early end */
    double offset[3];      /* of the hand since then, once it has stopped [m] */
    double speed[3];       /* of the hand at that tick [m/s] */
    double base;           /* sum of the forces that contact is measured against [N] */
    double felt[AVERAGED]; /* the last ones */
} guard_state;

typedef struct {
    player_guard *guards; /* NULL: none */
    double *left;         /* of each row of the table: share of the offset that is left, and its rate [1/s] */
    size_t count;         /* of guards */
    const double *rows;   /* of the table */
    size_t row_count, width;
    unsigned first; /* reference of the first output */
    guard_state state;
} guarded;

/* Reads the resources that the options `guards` and `left` name, if the table has them. */
fmu_status guarded_create(fmu *f, guarded *g);
void guarded_free(guarded *g);

/* Looks at the inputs at a tick, at which a row may end. */
void guarded_look(const fmu *f, guarded *g, int64_t tick);

/* Writes the outputs from the hand's position to the one that the option `moving` names; others, such as pushes, do
 * not move forward. */
void guarded_show(const fmu *f, const guarded *g, int64_t tick);

#endif
