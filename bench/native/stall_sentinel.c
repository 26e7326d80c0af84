// Report of the moments at which this machine ran nothing on one core: a hypervisor or firmware took it.
//
//   stall_sentinel CORE PRIORITY THRESHOLD_US
//
// Wakes every millisecond under SCHED_FIFO and prints "TIME LATE" (s, CLOCK_MONOTONIC) for each wake-up that was
// later than the threshold. Prints "ready" first; exit code 3 without the right to SCHED_FIFO. Ends on SIGTERM
// and with its parent.
#define _GNU_SOURCE
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#define PERIOD_NS 1000000LL

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
  if (argc != 4) {
    fprintf(stderr, "usage: stall_sentinel CORE PRIORITY THRESHOLD_US\n");
    return 2;
  }
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(atoi(argv[1]), &cores);
  struct sched_param priority = {.sched_priority = atoi(argv[2])};
  if (sched_setaffinity(0, sizeof cores, &cores) || sched_setscheduler(0, SCHED_FIFO, &priority)) {
    perror("stall_sentinel");
    return 3;
  }
  mlockall(MCL_CURRENT | MCL_FUTURE);
  int64_t threshold = atoll(argv[3]) * 1000LL;
  setvbuf(stdout, NULL, _IOLBF, 0);
  printf("ready\n");
  for (int64_t deadline = now() + PERIOD_NS;; deadline += PERIOD_NS) {
    sleep_until(deadline);
    int64_t late = now() - deadline;
    if (late > threshold) {
      printf("%.6f %.6f\n", deadline / 1e9, late / 1e9);
      deadline += late / PERIOD_NS * PERIOD_NS;
    }
  }
}
