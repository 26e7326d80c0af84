// Load that takes a share of one core under SCHED_FIFO, for a bounded time.
//
//   core_load CORE PRIORITY PERIOD_US BUSY_US SECONDS
//
// Computes BUSY_US of each PERIOD_US, then sleeps. Prints "ready" first; exit code 3 without the right to
// SCHED_FIFO. Ends after SECONDS, on SIGTERM and with its parent.
#define _GNU_SOURCE
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <time.h>

static int64_t now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(int64_t deadline) {
  struct timespec t = {deadline / 1000000000LL, deadline % 1000000000LL};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
}

int main(int argc, char **argv) {
  if (argc != 6) {
    fprintf(stderr, "usage: core_load CORE PRIORITY PERIOD_US BUSY_US SECONDS\n");
    return 2;
  }
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(atoi(argv[1]), &cores);
  struct sched_param priority = {.sched_priority = atoi(argv[2])};
  if (sched_setaffinity(0, sizeof cores, &cores) || sched_setscheduler(0, SCHED_FIFO, &priority)) {
    perror("core_load");
    return 3;
  }
  int64_t period = atoll(argv[3]) * 1000LL;
  int64_t busy = atoll(argv[4]) * 1000LL;
  printf("ready\n");
  fflush(stdout);
  int64_t begin = now();
  int64_t end = begin + atoll(argv[5]) * 1000000000LL;
  while (begin < end) {
    while (now() < begin + busy) {
    }
    begin += period;
    sleep_until(begin);
  }
  return 0;
}
