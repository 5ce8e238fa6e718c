/* Load generator: CLIENTS connections in one thread, each with one FC 04 request under way at a time.
 * Usage: modbus_load PORT CLIENTS REQUESTS SECONDS; ends after so many requests or so much time, whichever is first.
 * Prints "requests seconds p50_us p99_us". Every answer's length and function code are checked. */
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { ADDRESS = 1000, COUNT = 40, ANSWER_BYTES = 9 + 2 * COUNT, MAX_CLIENTS = 32 };

struct connection {
    uint8_t answer[ANSWER_BYTES];
    int received;
    double sent_s;
};

static double now_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int ask(int fd, struct connection *c)
{
    static const uint8_t request[] = {0, 1, 0, 0, 0, 6, 1, 4, ADDRESS >> 8, ADDRESS & 0xFF, 0, COUNT};

    c->received = 0;
    c->sent_s = now_s();
    return send(fd, request, sizeof request, MSG_NOSIGNAL) == (ssize_t)sizeof request;
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

static int connect_to(int port)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    int one = 1, fd = socket(AF_INET, SOCK_STREAM, 0);

    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (fd < 0 || connect(fd, (struct sockaddr *)&address, sizeof address) != 0)
        return -1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    return fd;
}

int main(int argc, char **argv)
{
    static struct connection connections[MAX_CLIENTS];
    struct pollfd fds[MAX_CLIENTS];
    int port = argc == 5 ? atoi(argv[1]) : 0, clients = argc == 5 ? atoi(argv[2]) : 0;
    long wanted = argc == 5 ? atol(argv[3]) : 0, done = 0;
    double limit_s = argc == 5 ? atof(argv[4]) : 0, start_s, end_s;
    float *latency_us;

    if (clients < 1 || clients > MAX_CLIENTS || wanted < 1 || wanted > 10000000) {
        fprintf(stderr, "usage: modbus_load PORT CLIENTS(1..32) REQUESTS SECONDS\n");
        return 2;
    }
    latency_us = malloc((size_t)wanted * sizeof *latency_us);
    for (int i = 0; i < clients; i++) {
        fds[i].fd = connect_to(port);
        fds[i].events = POLLIN;
        if (fds[i].fd < 0 || !latency_us) {
            perror("modbus_load: connect");
            return 1;
        }
    }
    start_s = end_s = now_s();
    for (int i = 0; i < clients; i++)
        if (!ask(fds[i].fd, &connections[i]))
            return 1;
    while (done < wanted && end_s - start_s < limit_s) {
        if (poll(fds, (nfds_t)clients, 2000) <= 0) {
            fprintf(stderr, "modbus_load: no answer for 2 s\n");
            return 1;
        }
        for (int i = 0; i < clients && done < wanted; i++) {
            struct connection *c = &connections[i];
            ssize_t n;

            if (!fds[i].revents)
                continue;
            n = recv(fds[i].fd, c->answer + c->received, (size_t)(ANSWER_BYTES - c->received), 0);
            if (n <= 0 || (c->received + n >= 9 && (c->answer[7] != 4 || c->answer[8] != 2 * COUNT))) {
                fprintf(stderr, "modbus_load: wrong answer or closed connection\n");
                return 1;
            }
            c->received += (int)n;
            if (c->received < ANSWER_BYTES)
                continue;
            end_s = now_s();
            latency_us[done++] = (float)((end_s - c->sent_s) * 1e6);
            if (!ask(fds[i].fd, c))
                return 1;
        }
    }
    qsort(latency_us, (size_t)done, sizeof *latency_us, by_value);
    printf("%ld %.6f %.1f %.1f\n", done, end_s - start_s, latency_us[done / 2], latency_us[done * 99 / 100]);
    return 0;
}
