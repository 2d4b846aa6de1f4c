/* The clock library: preloaded into a firmware built for simulation, it owns what the firmware takes for clock, threads
 * and sockets, and lets it run in steps that the world orders. One kernel thread; nothing outside is opened.
 */
#ifndef SAFLITE_PRELOAD_H
#define SAFLITE_PRELOAD_H

#include <stdint.h>
#include <sys/select.h>

#include "../native/link.h"

#define EXPORT __attribute__((visibility("default")))

/* threads.c: helper threads as coroutines of the main thread. */
enum { MAIN_THREAD = -1 };
int current_thread(void);
void wait_in_main(uint64_t until_ns, int limit, const fd_set *read); /* from a helper: until then, or data for it */
void resume_helpers(void);  /* from the main thread: each helper whose wait is over runs until it waits again */

/* clock.c */
uint64_t clock_now_ns(void);

/* sockets.c: what the firmware sends and receives. */
int sockets_readable(int limit, const fd_set *read);
void sockets_deliver(const LinkDown *down);
void sockets_collect(LinkUp *up);

/* gate.c: steps, forks, the end. */
void gate_step(uint64_t *deadline_ns);
_Noreturn void gate_exit(int code);

#endif
