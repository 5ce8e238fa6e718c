/* 200 reads with libmodbus, one after the other: it knows no other way. */
#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>

enum { ROUNDS = 50, LARGEST = 125 };

struct read {
    int function, address, count;
};

static const struct read reads[] = {{4, 0, 84}, {3, 1000, 70}, {4, 10, 12}, {3, 1002, 4}};

static int read_once(modbus_t *client, const struct read *wanted)
{
    uint16_t registers[LARGEST];
    int got = wanted->function == 4
        ? modbus_read_input_registers(client, wanted->address, wanted->count, registers)
        : modbus_read_registers(client, wanted->address, wanted->count, registers);

    if (got != wanted->count)
        return -1;
    printf("{\"function\": %d, \"address\": %d, \"registers\": [", wanted->function, wanted->address);
    for (int i = 0; i < got; i++)
        printf("%s%u", i ? ", " : "", registers[i]);
    printf("]}\n");
    return 0;
}

int main(int argc, char **argv)
{
    modbus_t *client = argc == 2 ? modbus_new_tcp("127.0.0.1", atoi(argv[1])) : NULL;
    int failed = !client || modbus_set_slave(client, 1) != 0 || modbus_connect(client) != 0;

    for (int round = 0; round < ROUNDS && !failed; round++)
        for (size_t i = 0; i < sizeof reads / sizeof *reads && !failed; i++)
            failed = read_once(client, &reads[i]) != 0;
    if (failed)
        fprintf(stderr, "libmodbus: %s\n", modbus_strerror(errno));
    modbus_close(client);
    modbus_free(client);
    return failed;
}
