/* Load generator: CLIENTS connections in one thread, each with one FC 04 request under way at a time.
 * Usage: modbus_load PORT CLIENTS REQUESTS SECONDS [CA CERTIFICATE KEY]; ends after so many requests or so much time,
 * whichever is first. With the three files (compiled with -DWITH_TLS -lssl -lcrypto): mutual TLS 1.3.
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
#ifdef WITH_TLS
#include <openssl/err.h>
#include <openssl/ssl.h>
#else
typedef void SSL;
typedef void SSL_CTX;
#endif

enum { ADDRESS = 1000, COUNT = 40, ANSWER_BYTES = 9 + 2 * COUNT, MAX_CLIENTS = 32 };

struct connection {
    uint8_t answer[ANSWER_BYTES];
    int fd, received;
    SSL *tls; /* NULL: plain */
    double sent_s;
};

static double now_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static ssize_t give(struct connection *c, const void *data, size_t size)
{
#ifdef WITH_TLS
    if (c->tls)
        return SSL_write(c->tls, data, (int)size);
#endif
    return send(c->fd, data, size, MSG_NOSIGNAL);
}

static ssize_t take(struct connection *c, void *data, size_t size)
{
#ifdef WITH_TLS
    if (c->tls)
        return SSL_read(c->tls, data, (int)size);
#endif
    return recv(c->fd, data, size, 0);
}

static int ask(struct connection *c)
{
    static const uint8_t request[] = {0, 1, 0, 0, 0, 6, 1, 4, ADDRESS >> 8, ADDRESS & 0xFF, 0, COUNT};

    c->received = 0;
    c->sent_s = now_s();
    return give(c, request, sizeof request) == (ssize_t)sizeof request;
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

/* A context with the client's certificate, or NULL. */
static SSL_CTX *secured(char **files)
{
#ifdef WITH_TLS
    SSL_CTX *context = SSL_CTX_new(TLS_client_method());

    SSL_CTX_set_min_proto_version(context, TLS1_3_VERSION);
    SSL_CTX_set_verify(context, SSL_VERIFY_PEER, NULL);
    if (SSL_CTX_load_verify_locations(context, files[0], NULL) == 1 &&
        SSL_CTX_use_certificate_file(context, files[1], SSL_FILETYPE_PEM) == 1 &&
        SSL_CTX_use_PrivateKey_file(context, files[2], SSL_FILETYPE_PEM) == 1)
        return context;
    ERR_print_errors_fp(stderr);
#else
    fprintf(stderr, "modbus_load: compiled without TLS, got %s\n", files[0]);
#endif
    return NULL;
}

static int shake_hands(struct connection *c, SSL_CTX *context)
{
#ifdef WITH_TLS
    c->tls = SSL_new(context);
    if (c->tls && SSL_set_fd(c->tls, c->fd) == 1 && SSL_connect(c->tls) == 1)
        return 1;
    ERR_print_errors_fp(stderr);
#else
    (void)c, (void)context;
#endif
    return 0;
}

int main(int argc, char **argv)
{
    static struct connection connections[MAX_CLIENTS];
    struct pollfd fds[MAX_CLIENTS];
    int complete = argc == 5 || argc == 8;
    int port = complete ? atoi(argv[1]) : 0, clients = complete ? atoi(argv[2]) : 0;
    long wanted = complete ? atol(argv[3]) : 0, done = 0;
    double limit_s = complete ? atof(argv[4]) : 0, start_s, end_s;
    SSL_CTX *context = argc == 8 ? secured(argv + 5) : NULL;
    float *latency_us;

    if (clients < 1 || clients > MAX_CLIENTS || wanted < 1 || wanted > 10000000) {
        fprintf(stderr, "usage: modbus_load PORT CLIENTS(1..32) REQUESTS SECONDS [CA CERTIFICATE KEY]\n");
        return 2;
    }
    if (argc == 8 && !context)
        return 1;
    latency_us = malloc((size_t)wanted * sizeof *latency_us);
    for (int i = 0; i < clients; i++) {
        fds[i].fd = connections[i].fd = connect_to(port);
        fds[i].events = POLLIN;
        if (fds[i].fd < 0 || !latency_us) {
            perror("modbus_load: connect");
            return 1;
        }
        if (context && !shake_hands(&connections[i], context))
            return 1;
    }
    start_s = end_s = now_s();
    for (int i = 0; i < clients; i++)
        if (!ask(&connections[i]))
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
            n = take(c, c->answer + c->received, (size_t)(ANSWER_BYTES - c->received));
            if (n <= 0 || (c->received + n >= 9 && (c->answer[7] != 4 || c->answer[8] != 2 * COUNT))) {
                fprintf(stderr, "modbus_load: wrong answer or closed connection\n");
                return 1;
            }
            c->received += (int)n;
            if (c->received < ANSWER_BYTES)
                continue;
            end_s = now_s();
            latency_us[done++] = (float)((end_s - c->sent_s) * 1e6);
            if (!ask(c))
                return 1;
        }
    }
    qsort(latency_us, (size_t)done, sizeof *latency_us, by_value);
    printf("%ld %.6f %.1f %.1f\n", done, end_s - start_s, latency_us[done / 2], latency_us[done * 99 / 100]);
    return 0;
}
