/* The yardstick: a Modbus TCP server on libmodbus, one thread, as many clients as select() takes.
 * Prints "listening PORT" and serves input registers 1000..1099 until its standard input closes. */
#include <arpa/inet.h>
#include <errno.h>
#include <modbus.h>
#include <netinet/in.h>
#include <stdio.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <unistd.h>

enum { FIRST_REGISTER = 1000, REGISTERS = 100, MAX_CLIENTS = 64 };

static int bound_port(int listener)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;

    if (getsockname(listener, (struct sockaddr *)&address, &size) != 0)
        return -1;
    return ntohs(address.sin_port);
}

int main(void)
{
    modbus_t *server = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *registers =
        modbus_mapping_new_start_address(0, 0, 0, 0, FIRST_REGISTER, REGISTERS, FIRST_REGISTER, REGISTERS);
    int listener = server && registers ? modbus_tcp_listen(server, MAX_CLIENTS) : -1;
    fd_set watched;
    int highest;

    if (listener < 0) {
        fprintf(stderr, "libmodbus server: %s\n", modbus_strerror(errno));
        return 1;
    }
    for (int i = 0; i < REGISTERS; i++)
        registers->tab_input_registers[i] = (uint16_t)i;
    printf("listening %d\n", bound_port(listener));
    fflush(stdout);

    FD_ZERO(&watched);
    FD_SET(STDIN_FILENO, &watched);
    FD_SET(listener, &watched);
    highest = listener;
    for (;;) {
        fd_set ready = watched;

        if (select(highest + 1, &ready, NULL, NULL, NULL) < 0)
            return 1;
        if (FD_ISSET(STDIN_FILENO, &ready))
            return 0;
        for (int fd = STDIN_FILENO + 1; fd <= highest; fd++) {
            uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
            int size;

            if (!FD_ISSET(fd, &ready))
                continue;
            if (fd == listener) {
                int client = accept(listener, NULL, NULL);

                if (client >= 0 && client < FD_SETSIZE) {
                    FD_SET(client, &watched);
                    highest = client > highest ? client : highest;
                }
                continue;
            }
            modbus_set_socket(server, fd);
            size = modbus_receive(server, request);
            if (size > 0)
                size = modbus_reply(server, request, size, registers);
            if (size < 0) {
                close(fd);
                FD_CLR(fd, &watched);
            }
        }
    }
}
