// 200 reads with modbus-serial, overlapped on one connection: told apart by their transaction numbers alone.
"use strict";
const ModbusRTU = require("modbus-serial");

const READS = [[4, 0, 84], [3, 1000, 70], [4, 10, 12], [3, 1002, 4]];
const ROUNDS = 50;

const client = new ModbusRTU();

async function read([code, address, count]) {
  const answer = code === 4
    ? await client.readInputRegisters(address, count)
    : await client.readHoldingRegisters(address, count);
  console.log(JSON.stringify({ function: code, address, registers: Array.from(answer.data) }));
}

async function main() {
  await client.connectTCP("127.0.0.1", { port: Number(process.argv[2]) });
  client.setID(1);
  client.setTimeout(5000);
  const asked = [];
  for (let round = 0; round < ROUNDS; round++) asked.push(...READS.map(read));
  await Promise.all(asked);
  client.close(() => {});
}

main().catch((error) => {
  console.error(error);
  process.exit(1);
});
