/* What the firmware's process and the world's say to each other: one message each way per step, on a SOCK_SEQPACKET
 * socket. Layouts of the firmware's own packets are those of its simulator target (state, RC, motors); nothing of it is
 * needed to build this.
 */
#ifndef SAFLITE_BETAFLIGHT_LINK_H
#define SAFLITE_BETAFLIGHT_LINK_H

#include <stddef.h>
#include <stdint.h>

#define LINK_PORTS 3            /* serial ports that can be talked to */
#define LINK_UARTS {1, 3, 4}    /* which of the firmware's; 2 is the GPS receiver's */
#define LINK_DOWN_MAX 4096      /* serial bytes per step to the firmware, all ports together */
#define LINK_UP_MAX 49152       /* and from it */
#define LINK_STATE 18
#define LINK_CHANNELS 16
#define LINK_MOTORS 4

enum { LINK_STEP = 1, LINK_FORK = 2 };   /* down */
enum { LINK_STEPPED = 1, LINK_EXIT = 2 }; /* up */
enum { LINK_HAS_STATE = 1, LINK_HAS_RC = 2 };

/* To the firmware. LINK_STEP: run on for `step_ns` with this. LINK_FORK (with a socket and a file for its console as
 * SCM_RIGHTS): fork; the fork goes on with that socket, and says what the last step said. */
typedef struct {
    uint32_t kind, has;
    uint64_t step_ns;
    double state[LINK_STATE];
    double rc_time;
    uint16_t rc[LINK_CHANNELS];
    uint32_t serial_bytes[LINK_PORTS];
    uint8_t serial[LINK_DOWN_MAX];
} LinkDown;

/* From the firmware: the step is done, or (LINK_EXIT) it ends itself with `code`. */
typedef struct {
    uint32_t kind, code;
    int32_t pid;
    uint32_t motor_messages; /* since the last step */
    uint64_t time_ns;        /* the firmware's clock */
    float motors[LINK_MOTORS];
    uint32_t serial_bytes[LINK_PORTS];
    uint8_t serial[LINK_UP_MAX];
} LinkUp;

#endif
