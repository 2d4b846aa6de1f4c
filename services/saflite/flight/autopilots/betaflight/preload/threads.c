/* Threads as coroutines: a helper runs when the main thread sleeps at a gate, until it waits for a socket. */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <ucontext.h>

#include "preload.h"

enum { HELPERS = 8, STACK_BYTES = 256 * 1024 };

typedef struct {
    ucontext_t context;
    void *(*run)(void *);
    void *argument;
    uint64_t until_ns; /* of its wait, which data for these sockets ends earlier */
    const fd_set *read;
    int limit, done;
} Helper;

static Helper helpers[HELPERS];
static ucontext_t main_context;
static int helper_count, running = MAIN_THREAD;

int current_thread(void) { return running; }

static void begin(void)
{
    Helper *helper = &helpers[running];
    helper->run(helper->argument);
    helper->done = 1;
    wait_in_main(0, 0, NULL);
}

static void resume(int which)
{
    running = which;
    swapcontext(&main_context, &helpers[which].context);
    running = MAIN_THREAD;
}

void wait_in_main(uint64_t until_ns, int limit, const fd_set *read)
{
    Helper *helper = &helpers[running];
    helper->until_ns = until_ns, helper->limit = limit, helper->read = read;
    swapcontext(&helper->context, &main_context);
}

static int is_over(const Helper *helper)
{
    return clock_now_ns() >= helper->until_ns || sockets_readable(helper->limit, helper->read);
}

void resume_helpers(void)
{
    for (int i = 0; i < helper_count; i++)
        if (!helpers[i].done && is_over(&helpers[i]))
            resume(i);
}

EXPORT int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*run)(void *), void *argument)
{
    (void)attributes;
    if (helper_count == HELPERS)
        return EAGAIN;
    Helper *helper = &helpers[helper_count];
    getcontext(&helper->context);
    helper->context.uc_stack.ss_sp = malloc(STACK_BYTES);
    helper->context.uc_stack.ss_size = STACK_BYTES;
    if (helper->context.uc_stack.ss_sp == NULL)
        return EAGAIN;
    makecontext(&helper->context, begin, 0);
    helper->run = run, helper->argument = argument;
    *thread = (pthread_t)++helper_count;
    resume(helper_count - 1);
    return 0;
}

EXPORT int pthread_join(pthread_t thread, void **result) /* asked for only on the way to exit() */
{
    (void)thread;
    if (result != NULL)
        *result = NULL;
    return 0;
}
