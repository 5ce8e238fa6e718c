// 200 reads with jsmodbus, all asked for before the first answer is there.
"use strict";
const net = require("net");
const { ModbusTCPClient } = require("jsmodbus");

const READS = [[4, 0, 84], [3, 1000, 70], [4, 10, 12], [3, 1002, 4]];
const ROUNDS = 50;

const socket = new net.Socket();
const client = new ModbusTCPClient(socket, 1, 5000);

async function read([code, address, count]) {
  const answer = code === 4
    ? await client.readInputRegisters(address, count)
    : await client.readHoldingRegisters(address, count);
  const registers = Array.from(answer.response.body.valuesAsArray);
  console.log(JSON.stringify({ function: code, address, registers }));
}

socket.on("connect", async () => {
  try {
    const asked = [];
    for (let round = 0; round < ROUNDS; round++) asked.push(...READS.map(read));
    await Promise.all(asked);
  } catch (error) {
    console.error(error);
    process.exitCode = 1;
  }
  socket.end();
});
socket.on("error", (error) => {
  console.error(error);
  process.exitCode = 1;
});
socket.connect({ host: "127.0.0.1", port: Number(process.argv[2]) });
