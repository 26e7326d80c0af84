// Registers and motion of each servo: what a write changes, what a read shows, the bus watchdog.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "servos.h"

#define VMAX (4.8 * 4096 / (2 * M_PI))  // ticks per s
#define TAU 0.03                        // s, time constant of the motion
#define WATCHDOG_NS 20000000LL          // unit of the bus watchdog

Servo servos[IDS];

void put(uint8_t *m, int a, int n, int32_t v) {
  for (int i = 0; i < n; i++) {
    m[a + i] = (uint32_t)v >> 8 * i;
  }
}

int32_t get(const uint8_t *m, int a, int n) {
  uint32_t v = 0;
  for (int i = 0; i < n; i++) {
    v |= (uint32_t)m[a + i] << 8 * i;
  }
  return n == 2 ? (int16_t)v : (int32_t)v;
}

// Return whether n bytes from a touch the registers lo to hi.
static int overlaps(int a, int n, int lo, int hi) {
  return a <= hi && a + n > lo;
}

// Integrate the position to time t.
static void move(Servo *s, int64_t t) {
  while (s->at < t) {
    double dt = (t - s->at) / 1e9;
    if (dt > 5e-4) {
      dt = 5e-4;
    }
    if (!s->mem[TORQUE_ENABLE]) {
      s->v = 0;
      s->at = t;
      return;
    }
    double goal = s->held ? s->hold : get(s->mem, GOAL_POSITION, 4), e = goal - s->x;
    if (fabs(e) < 0.01) {
      s->x = goal;
      s->v = 0;
      s->at = t;
      return;
    }
    s->v = fmax(-VMAX, fmin(VMAX, e / TAU));
    s->x += s->v * dt;
    s->at += (int64_t)(dt * 1e9) + (dt < 5e-4);
  }
}

// Bring a servo to time t, through the expiry of its watchdog if that lies before.
void advance(int id, int64_t t) {
  Servo *s = servos + id;
  int wd = s->mem[BUS_WATCHDOG];
  if (wd >= 1 && wd <= 127 && s->mem[TORQUE_ENABLE]) {
    int64_t due = s->fed + wd * WATCHDOG_NS;
    if (t > due) {
      move(s, due);
      s->held = 1;
      s->hold = s->x;
      s->v = 0;
      s->mem[BUS_WATCHDOG] = EXPIRED;
      log_event(due, id, "watchdog_expired", wd);
    }
  }
  move(s, t);
}

// Bring the registers of present values up to date.
void refresh(int id) {
  Servo *s = servos + id;
  uint8_t *m = s->mem;
  int32_t p = lrint(s->x), v = lrint(s->v * 60 / 4096 / 0.229);
  put(m, PRESENT_POSITION, 4, p);
  put(m, PRESENT_VELOCITY, 4, v);
  put(m, PRESENT_CURRENT, 2, lrint(s->v / VMAX * 40));
  put(m, PRESENT_PWM, 2, lrint(s->v / VMAX * 400));
  put(m, POSITION_TRAJECTORY, 4, s->held ? lrint(s->hold) : get(m, GOAL_POSITION, 4));
  put(m, VELOCITY_TRAJECTORY, 4, v);
  put(m, REALTIME_TICK, 2, (t_now - s->born) / 1000000 % 32768);
  m[MOVING] = labs(v) > get(m, MOVING_THRESHOLD, 4);
  m[MOVING_STATUS] = labs(get(m, GOAL_POSITION, 4) - p) < 10;
}

void reset(int id, int64_t t) {
  Servo *s = servos + id;
  memcpy(s->mem, s->boot, SIZE);
  s->held = 0;
  s->v = 0;
  s->at = s->born = s->fed = t;
  put(s->mem, GOAL_POSITION, 4, lrint(s->x));
  refresh(id);
}

// Return the register that an indirect data address stands for; else the address itself.
static int target(const uint8_t *m, int a) {
  int k = a >= 224 && a < 252 ? 168 + 2 * (a - 224) : a >= 634 && a < 662 ? 578 + 2 * (a - 634) : 0;
  if (!k) {
    return a;
  }
  int to = m[k] | m[k + 1] << 8;
  return to >= 64 && to < SIZE ? to : a;
}

int readable(int a, int n) {
  return n > 0 && a + n <= SIZE;
}

void block(int id, int a, int n, uint8_t *d) {
  refresh(id);
  for (int i = 0; i < n; i++) {
    d[i] = servos[id].mem[target(servos[id].mem, a + i)];
  }
}

// Return the error number of a write to a run of direct addresses; 0: permitted.
static int refusal(const uint8_t *m, int a, const uint8_t *d, int n, int goal) {
  int32_t g = goal ? get(d, GOAL_POSITION - a, 4) : 0;
  if (a < RAM && m[TORQUE_ENABLE]) {
    return ACCESS;
  }
  if (overlaps(a, n, 0, 7) || overlaps(a, n, 69, 70) || overlaps(a, n, REALTIME_TICK, 147)) {
    return ACCESS;
  }
  if (overlaps(a, n, GOAL_POSITION, GOAL_POSITION + 3) && !goal) {
    return LENGTH;
  }
  if (m[BUS_WATCHDOG] == EXPIRED && (overlaps(a, n, 100, 107) || goal)) {
    return RANGE;
  }
  if (overlaps(a, n, TORQUE_ENABLE, TORQUE_ENABLE) && d[TORQUE_ENABLE - a] > 1) {
    return RANGE;
  }
  if (overlaps(a, n, BUS_WATCHDOG, BUS_WATCHDOG) &&
      (d[BUS_WATCHDOG - a] > 127 || (m[BUS_WATCHDOG] == EXPIRED && d[BUS_WATCHDOG - a]))) {
    return RANGE;
  }
  if (goal && m[OPERATING_MODE] == 3 && (g < get(m, MIN_POSITION, 4) || g > get(m, MAX_POSITION, 4))) {
    return LIMIT;
  }
  return 0;
}

// Store a run of direct addresses. Returns the error number.
static int store(int id, int a, const uint8_t *d, int n) {
  Servo *s = servos + id;
  uint8_t *m = s->mem;
  if (!readable(a, n)) {
    return ACCESS;
  }
  int goal = a <= GOAL_POSITION && a + n >= GOAL_POSITION + 4;
  int error = refusal(m, a, d, n, goal);
  if (goal) {
    log_goal(id, get(d, GOAL_POSITION - a, 4), m[TORQUE_ENABLE], error);
  }
  if (error) {
    log_event(t_now, id, "refused", a);
    return error;
  }
  uint8_t torque = m[TORQUE_ENABLE];
  uint8_t watchdog = m[BUS_WATCHDOG];
  uint8_t mode = m[OPERATING_MODE];
  memcpy(m + a, d, n);
  if (a < RAM) {
    memcpy(s->boot + a, m + a, a + n > RAM ? RAM - a : n);
  }
  if (m[TORQUE_ENABLE] && (m[HARDWARE_ERROR] & m[SHUTDOWN])) {
    m[TORQUE_ENABLE] = 0;  // shut down: only a reboot restores
  }
  if (m[TORQUE_ENABLE] != torque) {
    log_event(t_now, id, "torque", m[TORQUE_ENABLE]);
    s->fed = t_now;
  }
  if (overlaps(a, n, BUS_WATCHDOG, BUS_WATCHDOG)) {
    log_event(t_now, id, "watchdog", m[BUS_WATCHDOG]);
    s->fed = t_now;
  }
  if (m[OPERATING_MODE] != mode) {
    put(m, PROFILE_ACCELERATION, 4, 0);
    put(m, PROFILE_VELOCITY, 4, 0);
  }
  if (goal || m[TORQUE_ENABLE] != torque) {
    s->held = m[BUS_WATCHDOG] == EXPIRED;
    s->hold = s->x;
  }
  if (watchdog == EXPIRED && m[BUS_WATCHDOG] == 0 && !goal) {
    s->held = 1;
  }
  return 0;
}

// Store data in pieces that are contiguous behind indirect addresses. Returns the last error number.
int write_to(int id, int a, const uint8_t *d, int n) {
  const uint8_t *m = servos[id].mem;
  int err = 0;
  if (n <= 0 || a + n > SIZE) {
    return ACCESS;
  }
  for (int i = 0; i < n;) {
    int to = target(m, a + i), k = 1;
    while (i + k < n && target(m, a + i + k) == to + k) {
      k++;
    }
    int e = store(id, to, d + i, k);
    if (e) {
      err = e;
    }
    i += k;
  }
  return err;
}

int answers(int id) {
  return id >= 0 && id < IDS && servos[id].here && !servos[id].mute && t_now >= servos[id].off_until;
}