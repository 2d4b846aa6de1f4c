/* Preloaded into a simulator build of ArduPilot: makes it wait for the world where the world says, and forks it there.
 *
 * SAFLITE_GATE holds the descriptor of a socket pair's end (SOCK_SEQPACKET), 1 where it flies on its own physics, 1 where
 * it keeps no log, and the ports of the world's physics and of its own receiver. The world orders by 4 bytes: how many
 * frames to run, or FORK with the descriptors that the fork goes on with in place of those it inherits. Its clock is that
 * of its frames, so nothing else has to be owned.
 */
#ifndef SAFLITE_ARDUPILOT_GATE_H
#define SAFLITE_ARDUPILOT_GATE_H

#include <stdint.h>
#include <sys/types.h>

enum { LOST = 3 }; /* exit code */

/* What a fork goes on with, in the order in which it is given; -1 while not known. */
enum { GATE_CHANNEL, GATE_CONSOLE, GATE_LINK, GATE_RECEIVER, GATE_PHYSICS, GATE_FILES };

typedef struct {
    int files[GATE_FILES];
    int own_physics, no_log;
    int forked;
    int parked; /* threads that stand for ever where they hold nothing: a fork does not miss them */
    int physics_port, receiver_port;
    pid_t parent; /* as the autopilot knows it; a fork's is another */
} Gate;

extern Gate gate;

void gate_frame_over(void);
void gate_await_world(void);

#endif
