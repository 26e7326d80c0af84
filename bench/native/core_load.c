// Load that takes a share of one core under SCHED_FIFO, for a bounded time.
//
//   core_load CORE PRIORITY PERIOD_US BUSY_US SECONDS
//
// Computes BUSY_US of each PERIOD_US, then sleeps. Prints "ready" first; exit code 3 without the right to
// SCHED_FIFO. Ends after SECONDS, on SIGTERM and with its parent.
#define _GNU_SOURCE
#include "realtime.h"

int main(int argc, char **argv) {
  if (argc != 6) {
    fprintf(stderr, "usage: core_load CORE PRIORITY PERIOD_US BUSY_US SECONDS\n");
    return 2;
  }
  take_core("core_load", argv[1], argv[2]);
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
