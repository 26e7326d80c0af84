// A bus of servos: what the three parts of the program share.
#pragma once
#include <stdint.h>

#define SIZE 662    // bytes of the control table of an XM430
#define IDS 253     // ids 0 to 252
#define RAM 64      // first register that a reboot resets
#define EXPIRED 255 // reading of the bus watchdog

// Registers (e-manual, XM430-W350, "Control Table")
enum {
  ID = 7,
  BAUD_RATE = 8,
  RETURN_DELAY = 9,
  OPERATING_MODE = 11,
  MOVING_THRESHOLD = 24,
  VELOCITY_LIMIT = 44,
  MAX_POSITION = 48,
  MIN_POSITION = 52,
  SHUTDOWN = 63,
  TORQUE_ENABLE = 64,
  STATUS_LEVEL = 68,
  HARDWARE_ERROR = 70,
  POSITION_P_GAIN = 84,
  BUS_WATCHDOG = 98,
  PROFILE_ACCELERATION = 108,
  PROFILE_VELOCITY = 112,
  GOAL_POSITION = 116,
  REALTIME_TICK = 120,
  MOVING = 122,
  MOVING_STATUS = 123,
  PRESENT_PWM = 124,
  PRESENT_CURRENT = 126,
  PRESENT_VELOCITY = 128,
  PRESENT_POSITION = 132,
  VELOCITY_TRAJECTORY = 136,
  POSITION_TRAJECTORY = 140,
};

// Error numbers of a status packet (e-manual, Protocol 2.0, "Error")
enum { RANGE = 4, LENGTH = 5, LIMIT = 6, ACCESS = 7 };

typedef struct {
  int here;               // on this bus
  int mute;               // told to be silent
  int held;               // stopped by the watchdog
  uint8_t mem[SIZE];      // registers now
  uint8_t boot[SIZE];     // what a reboot restores
  double x, v, hold;      // ticks, ticks/s, where it holds
  int64_t at;             // ns, time that the state is of
  int64_t born;           // ns, zero of its tick register
  int64_t fed;            // ns, the watchdog was last fed
  int64_t off_until;      // ns, rebooting until then
} Servo;

// servos.c
extern int64_t t_now;  // ns, CLOCK_MONOTONIC, when the bytes at hand were read
void log_goal(int id, int32_t tick, int torque, int error);
void log_event(int64_t t, int id, const char *what, long value);

// servos_registers.c
extern Servo servos[IDS];
void put(uint8_t *m, int a, int n, int32_t v);
int32_t get(const uint8_t *m, int a, int n);
void advance(int id, int64_t t);
void refresh(int id);
void reset(int id, int64_t t);
int readable(int a, int n);
void block(int id, int a, int n, uint8_t *d);
int write_to(int id, int a, const uint8_t *d, int n);
int answers(int id);

// servos_packets.c
extern uint8_t out[65536], in[65536];
extern int out_size, in_size;
extern int request_size;  // bytes of the packets that `parse` handled
extern int first_id;      // servo whose reply comes first
extern long packets, bad_crc;
extern int64_t worst_gap;  // ns between two packets under torque
void make_crc_table(void);
int parse(void);
