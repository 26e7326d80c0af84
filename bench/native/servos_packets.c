// Protocol 2.0: whole instruction packets in, status packets out. CRC, byte stuffing, chains of fast reads.
#include <string.h>

#include "servos.h"

#define REBOOT_NS 100000000LL
#define BROADCAST 0xFE

enum {
  PING = 0x01,
  READ = 0x02,
  WRITE = 0x03,
  REBOOT = 0x08,
  STATUS = 0x55,
  SYNC_READ = 0x82,
  SYNC_WRITE = 0x83,
  FAST_SYNC_READ = 0x8A,
  BULK_READ = 0x92,
  BULK_WRITE = 0x93,
  FAST_BULK_READ = 0x9A
};

uint8_t out[65536];
uint8_t in[65536];
int out_size;
int in_size;
int request_size;
int first_id;
long packets;
long bad_crc;
int64_t worst_gap;
static uint16_t table[256];
static uint16_t crc_run;
static int64_t last_packet;

void make_crc_table(void) {
  for (int i = 0; i < 256; i++) {
    uint16_t v = i << 8;
    for (int k = 0; k < 8; k++) {
      v = v & 0x8000 ? v << 1 ^ 0x8005 : v << 1;
    }
    table[i] = v;
  }
}

static uint16_t crc(uint16_t c, const uint8_t *p, int n) {
  while (n--) {
    c = (c << 8) ^ table[((c >> 8) ^ *p++) & 255];
  }
  return c;
}

static int stuff(uint8_t *to, const uint8_t *from, int n) {
  int o = 0;
  for (int i = 0; i < n; i++) {
    to[o++] = from[i];
    if (i >= 2 && from[i] == 0xFD && from[i - 1] == 0xFF && from[i - 2] == 0xFF) {
      to[o++] = 0xFD;
    }
  }
  return o;
}

static int alert(int id) {
  return servos[id].mem[HARDWARE_ERROR] ? 0x80 : 0;
}

static void status(int id, int err, const uint8_t *d, int n) {
  if (out_size + 2 * n + 64 > (int)sizeof out) {
    return;
  }
  uint8_t *p = out + out_size, body[SIZE + 8];
  body[0] = 0x55;
  body[1] = err | alert(id);
  if (n) {
    memcpy(body + 2, d, n);
  }
  memcpy(p, "\xFF\xFF\xFD\0", 4);
  p[4] = id;
  if (!out_size) {
    first_id = id;
  }
  int m = stuff(p + 7, body, n + 2), len = m + 2;
  p[5] = len;
  p[6] = len >> 8;
  uint16_t c = crc(0, p, 7 + m);
  p[7 + m] = c;
  p[8 + m] = c >> 8;
  out_size += 9 + m;
}

static void fast_begin(int id, int total) {
  uint8_t *p = out + out_size;
  if (!out_size) {
    first_id = id;
  }
  memcpy(p, "\xFF\xFF\xFD\0\xFE", 5);
  p[5] = total;
  p[6] = total >> 8;
  p[7] = 0x55;
  crc_run = crc(0, p, 8);
  out_size += 8;
}

static void fast_one(int id, int a, int n) {
  uint8_t *p = out + out_size;
  p[0] = alert(id);
  p[1] = id;
  block(id, a, n, p + 2);
  crc_run = crc(crc_run, p, n + 2);
  p[n + 2] = crc_run;
  p[n + 3] = crc_run >> 8;
  crc_run = crc(crc_run, p + n + 2, 2);
  out_size += n + 4;
}

static void reply(int id, int level, int err, const uint8_t *d, int n) {
  if (servos[id].mem[STATUS_LEVEL] >= level) {
    status(id, err, d, n);
  }
}

static void read_reply(int id, int a, int n) {
  uint8_t d[SIZE];
  if (!answers(id)) {
    return;
  }
  if (readable(a, n)) {
    block(id, a, n, d);
    reply(id, 1, 0, d, n);
  } else {
    reply(id, 1, 7, 0, 0);
  }
}

static void ping_reply(int id) {
  refresh(id);
  uint8_t *m = servos[id].mem, d[3] = {m[0], m[1], m[6]};
  status(id, 0, d, 3);
}

// Answer a ping, a read or a write of one servo, or of all by the broadcast id.
static void handle_single(int id, int instruction, const uint8_t *q, int np) {
  int a = np >= 2 ? q[0] | q[1] << 8 : 0;
  int n = np >= 4 ? q[2] | q[3] << 8 : 0;
  if (instruction == READ && np == 4) {
    read_reply(id, a, n);
    return;
  }
  for (int i = 0; i < IDS; i++) {
    if (!answers(i) || (i != id && id != BROADCAST)) {
      continue;
    }
    if (instruction == PING) {
      ping_reply(i);
    } else if (instruction == WRITE && np >= 3) {
      int level = servos[i].mem[STATUS_LEVEL];
      int error = write_to(i, a, q + 2, np - 2);
      if (i == id && level == 2) {
        status(i, error, 0, 0);
      }
    } else if (instruction == REBOOT) {
      if (i == id) {
        reply(i, 2, 0, 0, 0);
      }
      reset(i, t_now);
      servos[i].off_until = t_now + REBOOT_NS;
      log_event(t_now, i, "reboot", 0);
    }
  }
}

// Answer a fast read. The first servo sends the header; a silent one ends the chain.
static void handle_fast(int instruction, const uint8_t *q, int np) {
  int sync = instruction == FAST_SYNC_READ;
  int first = sync ? 4 : 0;
  int step = sync ? 1 : 5;
  int last = sync ? np : np - 4;
  int total = 1;
  for (int i = first; i < last; i += step) {
    const uint8_t *size = sync ? q + 2 : q + i + 3;
    total += 4 + (size[0] | size[1] << 8);
  }
  for (int i = first; i < last && answers(q[i]); i += step) {
    const uint8_t *block = sync ? q : q + i + 1;
    int a = block[0] | block[1] << 8;
    int n = block[2] | block[3] << 8;
    if (!readable(a, n)) {
      break;
    }
    if (i == first) {
      fast_begin(q[i], total);
    }
    fast_one(q[i], a, n);
  }
}

// Answer a read or a write of several servos.
static void handle_group(int instruction, const uint8_t *q, int np) {
  int a = np >= 2 ? q[0] | q[1] << 8 : 0;
  int n = np >= 4 ? q[2] | q[3] << 8 : 0;
  if (instruction == SYNC_READ) {
    for (int i = 4; i < np; i++) {
      read_reply(q[i], a, n);
    }
  } else if (instruction == BULK_READ) {
    for (int i = 0; i + 4 < np; i += 5) {
      read_reply(q[i], q[i + 1] | q[i + 2] << 8, q[i + 3] | q[i + 4] << 8);
    }
  } else if (instruction == SYNC_WRITE && n >= 1 && (np - 4) % (n + 1) == 0) {
    for (int i = 4; i + n < np; i += n + 1) {
      if (answers(q[i])) {
        write_to(q[i], a, q + i + 1, n);
      }
    }
  } else if (instruction == BULK_WRITE) {
    for (int i = 0, k; i + 4 < np && i + 5 + (k = q[i + 3] | q[i + 4] << 8) <= np; i += 5 + k) {
      if (answers(q[i])) {
        write_to(q[i], q[i + 1] | q[i + 2] << 8, q + i + 5, k);
      }
    }
  }
}

// Bring all servos to the present and feed their watchdogs: any intact packet does.
static void feed_all(void) {
  int torque = 0;
  for (int i = 0; i < IDS; i++) {
    if (servos[i].here) {
      advance(i, t_now);
      torque |= servos[i].mem[TORQUE_ENABLE];
      if (answers(i)) {
        servos[i].fed = t_now;
      }
    }
  }
  if (torque && last_packet && t_now - last_packet > worst_gap) {
    worst_gap = t_now - last_packet;
  }
  last_packet = t_now;
}

// Handle an unstuffed packet whose length field is len.
static void handle(const uint8_t *p, int len) {
  int instruction = p[7];
  packets++;
  feed_all();
  switch (instruction) {
    case PING:
    case READ:
    case WRITE:
    case REBOOT:
      handle_single(p[4], instruction, p + 8, len - 3);
      break;
    case SYNC_READ:
    case SYNC_WRITE:
    case BULK_READ:
    case BULK_WRITE:
      handle_group(instruction, p + 8, len - 3);
      break;
    case FAST_SYNC_READ:
    case FAST_BULK_READ:
      handle_fast(instruction, p + 8, len - 3);
      break;
    case STATUS:
      break;
    default:
      if (answers(p[4])) {
        status(p[4], 2, 0, 0);
      }
  }
}

// Handle all whole packets that have come. Returns whether there were any.
int parse(void) {
  int did = 0;
  for (;;) {
    int s = 0;
    while (s + 3 < in_size && !(in[s] == 0xFF && in[s + 1] == 0xFF && in[s + 2] == 0xFD && in[s + 3] == 0)) {
      s++;
    }
    if (s) {
      memmove(in, in + s, in_size - s);
      in_size -= s;
    }
    if (in_size < 10) {
      return did;
    }
    int len = in[5] | in[6] << 8;
    if (len < 3 || len > 4096) {
      memmove(in, in + 3, in_size - 3);
      in_size -= 3;
      continue;
    }
    if (in_size < len + 7) {
      return did;
    }
    if (crc(0, in, len + 5) != (in[len + 5] | in[len + 6] << 8)) {
      bad_crc++;
      log_event(t_now, 0, "bad_crc", len);
      memmove(in, in + 3, in_size - 3);
      in_size -= 3;
      continue;
    }
    uint8_t pk[8192];
    memcpy(pk, in, 8);
    int o = 8;
    for (int i = 8; i < len + 5; i++) {
      pk[o++] = in[i];
      if (i >= 10 && in[i] == 0xFD && in[i - 1] == 0xFF && in[i - 2] == 0xFF && i + 1 < len + 5 &&
          in[i + 1] == 0xFD) {
        i++;
      }
    }
    request_size += len + 7;
    handle(pk, o - 5);
    did = 1;
    memmove(in, in + len + 7, in_size - len - 7);
    in_size -= len + 7;
  }
}