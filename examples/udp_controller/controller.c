/* A controller at the other end of `rig: hardware: udp`, with a simulated actuator on a specimen.
 * docs/udp.md has the layout of the datagrams. For a little-endian machine (x86, ARM).
 *   gcc -O2 -Wall -Wextra -Werror controller.c -o controller -lm
 *   ./controller PORT HOST:PORT RATE controller|host TIMEOUT
 * Its own port, that of the host that may command it, samples a second, who is the clock, and the
 * silence (s) after which it closes its valve by itself. */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifndef AXES
#define AXES 1
#endif
enum { CLOSED, RUN };
enum { LATE, LOST, REPEATED, REORDERED, CORRUPTED, FOREIGN, TRUNCATED, UNARMED, KINDS };
static const char *const names[KINDS] = {
    "late", "lost", "repeated", "reordered", "corrupted", "foreign", "truncated", "unarmed"};
struct command { char magic[4]; uint16_t version, axes; uint32_t step, mode; double drive[AXES]; };
struct sample { char magic[4]; uint16_t version, axes; uint32_t step, state;
                double time, x[AXES], v[AXES], a[AXES], f[AXES]; uint32_t crc; };
enum { COMMAND_SIZE = 20 + 8 * AXES, SAMPLE_SIZE = 28 + 32 * AXES }; /* of the datagrams */

/* The paper's rig, see seft's docs/rig.md for the equations. */
static const double MASS = 52.7, DAMPING = 800.3, STIFFNESS = 2.11e5, FLOW_GAIN = 0.0403,
    OIL = 1.664e7, LEAKAGE = 50, CAPACITY = 24500, VALVE = 6.283185307 * 70, VALVE_DAMPING = 0.6,
    FRICTION = 10, FRICTION_VELOCITY = 0.005, DEAD_TIME = 0.001, LONGEST_STEP = 1e-4,
    NOISE[4] = {5e-6, 1e-3, 0.05, 3}, LIMIT = 10; /* m, m/s, m/s^2, N; V */
/* s in which the valve closes. At once, a mass M with velocity v would be hammered by the oil with
 * a force of v sqrt(OIL M): so it takes longer than a period of the oil column (90 Hz). */
static const double CLOSE_TIME = 0.02;
static long counts[KINDS];
static int is_clock, is_open, is_armed, knows_last;
static uint32_t sent, last, seen; /* newest sample and command; bit i: step last - i was obeyed */
static double wanted[AXES], drive[AXES], closing[AXES], safe[AXES], heard, period;
static volatile sig_atomic_t ending;

static void end(int signal) { (void)signal, ending = 1; }
static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}
static uint32_t crc32(const void *data, size_t size) { /* as zlib's */
    uint32_t crc = ~0u;
    for (const uint8_t *byte = data; size--; byte++) {
        crc ^= *byte;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

/* ---- the simulated rig: x, v, oil force p, valve opening w and its rate ---- */
static double state[AXES][5], delayed[AXES][64];
static double piston_friction(double v) { return FRICTION * tanh(v / FRICTION_VELOCITY); }
static void rates(const double *z, double u, double *dz) {
    double w = fmax(-LIMIT, fmin(LIMIT, z[3])), left = 1 - copysign(z[2] / CAPACITY, w * z[2]);
    dz[0] = z[1];
    dz[1] = (z[2] - piston_friction(z[1]) - DAMPING * z[1] - STIFFNESS * z[0]) / MASS;
    dz[2] = OIL * (FLOW_GAIN * w * copysign(sqrt(fabs(left)), left) - z[1]) - LEAKAGE * z[2];
    dz[3] = z[4];
    dz[4] = VALVE * VALVE * (u - z[3]) - 2 * VALVE_DAMPING * VALVE * z[4];
}
static void integrate(void) { /* one period, by Runge and Kutta's method */
    static unsigned place;
    int steps = (int)ceil(period / LONGEST_STEP * (1 - 1e-9));
    double h = period / steps, parts[4] = {0, h / 2, h / 2, h}, weights[4] = {1, 2, 2, 1};
    unsigned dead = (unsigned)fmin(63, round(DEAD_TIME / h));
    for (int k = 0; k < steps; k++, place++)
        for (int i = 0; i < AXES; i++) {
            double *z = state[i], next[5], dz[5] = {0}, at[5];
            delayed[i][place % 64] = drive[i];
            memcpy(next, z, sizeof next);
            for (int stage = 0; stage < 4; stage++) {
                for (int j = 0; j < 5; j++) at[j] = z[j] + parts[stage] * dz[j];
                rates(at, delayed[i][(place - dead) % 64], dz);
                for (int j = 0; j < 5; j++) next[j] += h / 6 * weights[stage] * dz[j];
            }
            memcpy(z, next, sizeof next);
        }
}
static double noise(void) { return sqrt(12) * (rand() / (double)RAND_MAX - 0.5); } /* RMS 1 */

/* ---- commands ---- */
static void shut(const double *to, const char *why) {
    if (!is_open && !memcmp(safe, to, sizeof safe)) return;
    if (is_open) is_open = 0, printf("step %u: closes: %s\n", is_clock ? sent : last, why);
    for (int i = 0; i < AXES; i++)
        safe[i] = to[i], closing[i] = fabs(drive[i] - safe[i]) * period / CLOSE_TIME;
}
static void move_valve(void) {
    for (int i = 0; i < AXES; i++) {
        double left = safe[i] - drive[i];
        if (is_open) drive[i] = wanted[i];
        else if (fabs(left) > closing[i] * 1.001) drive[i] += copysign(closing[i], left);
        else if (left) drive[i] = safe[i], printf("axis %d: valve at %g V\n", i, safe[i]);
    }
}
static int out_of_order(const struct command *c) { /* its kind, or -1 for one to obey */
    int64_t ahead = knows_last ? (int32_t)(c->step - last) : 1;
    if (is_clock && (int32_t)(c->step - sent) > 0) return FOREIGN; /* answers nothing */
    if (ahead == 0 && c->mode == CLOSED && is_open && is_clock) return -1; /* a stop after all */
    if (ahead <= 0)
        return ahead > -32 && seen >> -ahead & 1 ? REPEATED : ahead == -1 ? REORDERED : LATE;
    if (is_clock && c->step != sent) return LATE;
    counts[LOST] += ahead - 1;
    seen = ahead < 32 ? seen << ahead | 1 : 1;
    last = c->step, knows_last = 1;
    return -1;
}
static int fault_of(const uint8_t *raw, ssize_t size, struct command *c) {
    uint32_t crc = 0;
    if (size >= 20) memcpy(&crc, raw + size - 4, 4);
    if (size < 20 || crc != crc32(raw, size - 4)) /* no whole datagram */
        return size == COMMAND_SIZE ? CORRUPTED : TRUNCATED;
    memcpy(c, raw, 16);
    if (memcmp(c->magic, "SEFC", 4) || c->version != 1 || c->axes != AXES) return FOREIGN;
    if (size != COMMAND_SIZE) return TRUNCATED;
    memcpy(c->drive, raw + 16, sizeof c->drive);
    for (int i = 0; i < AXES; i++)
        if (!(fabs(c->drive[i]) <= LIMIT)) return CORRUPTED; /* nor is NaN */
    return c->mode > RUN ? CORRUPTED : out_of_order(c);
}
static int obey(const uint8_t *raw, ssize_t size) {
    struct command c;
    int kind = fault_of(raw, size, &c);
    if (kind >= 0) return counts[kind]++, 0;
    heard = now();
    if (c.mode == CLOSED) is_armed = 1, shut(c.drive, "commanded");
    else if (!is_armed) counts[UNARMED]++; /* the host must close it before it may open it */
    else {
        if (!is_open) is_open = 1, printf("step %u: open\n", c.step);
        memcpy(wanted, c.drive, sizeof wanted);
    }
    return 1;
}
static void send_sample(int port, const struct sockaddr_in *host, double time) {
    struct sample s = {"SEFS", 1, AXES, is_clock ? ++sent : last, is_open, time,
                       {0}, {0}, {0}, {0}, 0};
    for (int i = 0; i < AXES; i++) {
        double dz[5];
        rates(state[i], drive[i], dz);
        s.x[i] = state[i][0] + NOISE[0] * noise();
        s.v[i] = state[i][1] + NOISE[1] * noise();
        s.a[i] = dz[1] + NOISE[2] * noise();
        s.f[i] = state[i][2] - piston_friction(state[i][1]) + NOISE[3] * noise();
    }
    s.crc = crc32(&s, SAMPLE_SIZE - 4);
    sendto(port, &s, SAMPLE_SIZE, 0, (const void *)host, sizeof *host);
}

int main(int count, char **words) {
    char *colon = count == 6 ? strchr(words[2], ':') : NULL;
    if (!colon) return fputs("PORT HOST:PORT RATE controller|host TIMEOUT\n", stderr), 2;
    *colon = 0;
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons(atoi(words[1]))}, from;
    struct sockaddr_in host = {.sin_family = AF_INET, .sin_port = htons(atoi(colon + 1))};
    int port = socket(AF_INET, SOCK_DGRAM, 0);
    if (inet_pton(AF_INET, words[2], &host.sin_addr) != 1 || bind(port, (void *)&own, sizeof own))
        return perror("HOST must be four numbers, and PORT free"), 2;
    period = 1 / atof(words[3]), is_clock = !strcmp(words[4], "controller");
    double timeout = atof(words[5]), deadline = now(), time = 0;
    uint8_t raw[4096];
    signal(SIGTERM, end), signal(SIGINT, end), setvbuf(stdout, NULL, _IOLBF, 0), puts("ready");
    while (!ending) {
        if (is_clock) { /* while this process stands still, so does its specimen */
            deadline = fmax(deadline + period, now() + period / 2);
            struct timespec at = {(time_t)deadline, (long)(1e9 * fmod(deadline, 1))};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
        } else { /* a command, or silence of a period */
            struct pollfd any = {port, POLLIN, 0};
            poll(&any, 1, (int)ceil(1e3 * period));
        }
        if (now() - heard > timeout) /* either side may have been started again: begin anew */
            is_armed = knows_last = 0, shut(safe, "silence");
        int is_asked = 0;
        for (int i = 0; i < 1000 && (is_clock || !is_asked); i++) {
            socklen_t length = sizeof from;
            ssize_t size = recvfrom(port, raw, sizeof raw, MSG_DONTWAIT, (void *)&from, &length);
            if (size < 0) break;
            if (from.sin_addr.s_addr != host.sin_addr.s_addr || from.sin_port != host.sin_port)
                counts[FOREIGN]++;
            else is_asked |= obey(raw, size);
        }
        if (!is_clock && !is_asked && is_armed) continue; /* simulated time waits for the host */
        integrate();
        time += period;
        move_valve(); /* the command holds from this sample on */
        if (is_clock || is_asked) send_sample(port, &host, time);
    }
    for (int kind = 0; kind < KINDS; kind++) printf("%s %ld ", names[kind], counts[kind]);
    return puts(""), 0;
}
