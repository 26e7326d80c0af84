// Report of the moments at which this machine ran nothing on one core: a hypervisor or firmware took it.
//
//   stall_sentinel CORE PRIORITY THRESHOLD_US
//
// Wakes every millisecond under SCHED_FIFO and prints "TIME LATE" (s, CLOCK_MONOTONIC) for each wake-up that was
// later than the threshold. Prints "ready" first; exit code 3 without the right to SCHED_FIFO. Ends on SIGTERM
// and with its parent.
#define _GNU_SOURCE
#include <sys/mman.h>

#include "realtime.h"

#define PERIOD_NS 1000000LL

int main(int argc, char **argv) {
  if (argc != 4) {
    fprintf(stderr, "usage: stall_sentinel CORE PRIORITY THRESHOLD_US\n");
    return 2;
  }
  take_core("stall_sentinel", argv[1], argv[2]);
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
