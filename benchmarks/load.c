/* Load on a MAVLink proxy: HIL_SENSOR frames in at one UDP port, out at another.

   load IN_PORT OUT_PORT window WINDOW COUNT     closed loop, WINDOW frames in flight
   load IN_PORT OUT_PORT rate PER_SECOND COUNT   open loop at a steady rate
   load IN_PORT OUT_PORT stamped PER_SECOND COUNT    the same, with kernel arrival timestamps

   It never sleeps, so that its own wake-up is not measured; `stamped` also excludes its own
   scheduling delays. Prints one line: sent received lost seconds p50_us p99_us p999_us (latency,
   send to receive). */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { PAYLOAD = 64, FRAME = 12 + PAYLOAD, BATCH = 64, ID = 107, CRC_EXTRA = 108 };

static uint64_t read_ns(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000ull + t.tv_nsec;
}

static uint64_t now_ns(void)
{
    return read_ns(CLOCK_MONOTONIC);
}

static uint16_t crc(const uint8_t *data, size_t length)
{
    uint16_t sum = 0xFFFF;
    for (size_t i = 0; i <= length; i++) {
        uint8_t byte = (i < length ? data[i] : CRC_EXTRA) ^ (uint8_t)sum;
        byte ^= byte << 4;
        sum = (sum >> 8) ^ (byte << 8) ^ (byte << 3) ^ (byte >> 4);
    }
    return sum;
}

/* Frame number n: time_usec counts in 100 us from 1 s and identifies the frame. */
static void make(uint8_t *frame, uint64_t n)
{
    static const uint8_t head[10] = {0xFD, PAYLOAD, 0, 0, 0, 1, 51, ID, 0, 0};
    uint64_t t_us = 1000000 + n * 100;
    uint32_t updated = 0x1FFF;
    memcpy(frame, head, 10);
    frame[4] = n;
    memset(frame + 10, 0, PAYLOAD);
    memcpy(frame + 10, &t_us, 8);
    for (int i = 0; i < 13; i++) {
        float value = 0.25f * (i + 1);
        memcpy(frame + 18 + 4 * i, &value, 4);
    }
    memcpy(frame + 70, &updated, 4);
    uint16_t sum = crc(frame + 1, 9 + PAYLOAD);
    memcpy(frame + 10 + PAYLOAD, &sum, 2);
}

static int compare(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

static uint8_t outgoing[BATCH][FRAME], incoming[BATCH][2048];
static struct mmsghdr to_send[BATCH], to_receive[BATCH];
static struct iovec send_parts[BATCH], receive_parts[BATCH];
static char stamps[BATCH][CMSG_SPACE(sizeof(struct timespec))];
static uint64_t *sent_at, total, received, sent, wall_ahead;
static uint32_t *latencies;
static int in, out;

static void send_some(uint64_t count)
{
    if (count > BATCH)
        count = BATCH;
    for (uint64_t i = 0; i < count; i++) {
        make(outgoing[i], sent + i);
        sent_at[sent + i] = now_ns();
    }
    int done = sendmmsg(in, to_send, count, 0);
    sent += done > 0 ? done : 0;
}

/* When the kernel had a datagram, on the monotonic clock; `now` where it does not say. */
static uint64_t arrival(struct msghdr *head, uint64_t now)
{
    struct timespec t;
    struct cmsghdr *note = CMSG_FIRSTHDR(head);
    if (!note || note->cmsg_type != SCM_TIMESTAMPNS)
        return now;
    memcpy(&t, CMSG_DATA(note), sizeof t);
    return t.tv_sec * 1000000000ull + t.tv_nsec - wall_ahead;
}

static int receive_some(void)
{
    for (int i = 0; i < BATCH; i++)
        to_receive[i].msg_hdr.msg_controllen = sizeof stamps[i];
    int count = recvmmsg(out, to_receive, BATCH, MSG_DONTWAIT, NULL);
    uint64_t now = now_ns();
    for (int i = 0; i < count; i++) {
        uint64_t t_us, n;
        if (to_receive[i].msg_len < 18 || incoming[i][7] != ID)
            continue; /* the proxy's own messages */
        memcpy(&t_us, incoming[i] + 10, 8);
        n = (t_us - 1000000) / 100;
        if (n < total)
            latencies[received++] = arrival(&to_receive[i].msg_hdr, now) - sent_at[n];
    }
    return count;
}

static int quiet(uint64_t since, unsigned patience_ms)
{
    return now_ns() - since > patience_ms * 1000000ull;
}

int main(int count, char **words)
{
    if (count != 6)
        return 2;
    struct sockaddr_in address = {.sin_family = AF_INET};
    int size = 8 << 20, closed = !strcmp(words[3], "window"), on = !strcmp(words[3], "stamped");
    uint64_t pace = strtoull(words[4], 0, 10), lost = 0;
    total = strtoull(words[5], 0, 10);
    sent_at = calloc(total + BATCH, 8);
    latencies = calloc(total + BATCH, 4);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    in = socket(AF_INET, SOCK_DGRAM, 0);
    out = socket(AF_INET, SOCK_DGRAM, 0);
    wall_ahead = read_ns(CLOCK_REALTIME) - now_ns();
    setsockopt(out, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    setsockopt(out, SOL_SOCKET, 33, &size, sizeof size);
    setsockopt(in, SOL_SOCKET, 32, &size, sizeof size);
    address.sin_port = htons(atoi(words[2]));
    if (bind(out, (struct sockaddr *)&address, sizeof address))
        return perror("bind"), 1;
    address.sin_port = htons(atoi(words[1]));
    connect(in, (struct sockaddr *)&address, sizeof address);
    for (int i = 0; i < BATCH; i++) {
        send_parts[i] = (struct iovec){outgoing[i], FRAME};
        receive_parts[i] = (struct iovec){incoming[i], sizeof incoming[i]};
        to_send[i].msg_hdr = (struct msghdr){.msg_iov = &send_parts[i], .msg_iovlen = 1};
        to_receive[i].msg_hdr = (struct msghdr){
            .msg_iov = &receive_parts[i], .msg_iovlen = 1, .msg_control = stamps[i]};
    }
    uint64_t start = now_ns(), end = start, last = start;
    while (received + lost < total) {
        if (closed) {
            uint64_t flying = sent - received - lost;
            if (flying < pace && sent < total) {
                send_some(sent + pace - flying > total ? total - sent : pace - flying);
                last = now_ns();
            } else if (quiet(last, 200))
                lost = sent - received;
        } else if (sent < total) {
            uint64_t due = (now_ns() - start) * pace / 1000000000ull + 1;
            if (due > sent)
                send_some(due > total ? total - sent : due - sent);
            last = now_ns();
        } else if (quiet(last, 300)) {
            lost = sent - received;
        }
        if (receive_some() > 0)
            end = last = now_ns();
    }
    qsort(latencies, received, 4, compare);
    printf("%lu %lu %lu %.6f %.1f %.1f %.1f\n", sent, received, sent - received, (end - start) * 1e-9,
           received ? latencies[received / 2] * 1e-3 : 0.0,
           received ? latencies[received * 99 / 100] * 1e-3 : 0.0,
           received ? latencies[received * 999 / 1000] * 1e-3 : 0.0);
    return 0;
}
