// Monotonic time, and one core with a SCHED_FIFO priority, of the programs that measure or load a core.
#ifndef REALTIME_H
#define REALTIME_H

#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <time.h>

// ns, CLOCK_MONOTONIC
static int64_t now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(int64_t deadline) {
  struct timespec t = {deadline / 1000000000LL, deadline % 1000000000LL};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

// Run on `core` alone with `priority` under SCHED_FIFO, until the parent ends. Without the right to it: exit code 3.
static void take_core(const char *program, const char *core, const char *priority) {
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(atoi(core), &cores);
  struct sched_param wanted = {.sched_priority = atoi(priority)};
  if (sched_setaffinity(0, sizeof cores, &cores) || sched_setscheduler(0, SCHED_FIFO, &wanted)) {
    perror(program);
    exit(3);
  }
}

#endif
