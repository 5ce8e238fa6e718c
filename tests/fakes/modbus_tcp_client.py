"""A Modbus TCP client written from the specification alone: it shares no code with the server."""

import asyncio


def read_request(function: int, address: int, count: int, *, transaction: int = 1, unit: int = 1) -> bytes:
    """A whole frame of function 3 or 4."""
    pdu = bytes([function, address >> 8, address & 0xFF, count >> 8, count & 0xFF])
    return frame(pdu, transaction=transaction, unit=unit)


def frame(pdu: bytes, *, transaction: int = 1, unit: int = 1) -> bytes:
    """MBAP header and PDU."""
    return transaction.to_bytes(2, "big") + b"\0\0" + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu


def split_frames(data: bytes) -> list[bytes]:
    """The whole frames that lie one behind the other; raises ValueError if something is left over."""
    frames: list[bytes] = []
    while data:
        end = 6 + int.from_bytes(data[4:6], "big")
        if len(data) < 7 or end > len(data):
            raise ValueError(f"half a frame: {data.hex()}")
        frames.append(data[:end])
        data = data[end:]
    return frames


class ModbusTcpClient:
    """One connection; sends any bytes, receives frame by frame."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    @classmethod
    async def connect(cls, port: int, source_host: str | None = None) -> "ModbusTcpClient":
        local = None if source_host is None else (source_host, 0)
        return cls(*await asyncio.open_connection("127.0.0.1", port, local_addr=local))

    async def send(self, data: bytes) -> None:
        self._writer.write(data)
        await self._writer.drain()

    async def receive(self) -> bytes:
        """The next frame."""
        header = await self._reader.readexactly(6)
        return header + await self._reader.readexactly(int.from_bytes(header[4:6], "big"))

    async def ask(self, data: bytes) -> bytes:
        await self.send(data)
        return await self.receive()

    async def at_end(self) -> bool:
        """True once the server has closed without sending anything more."""
        try:
            return await self._reader.read(1) == b""
        except ConnectionResetError:
            return True

    async def close(self) -> None:
        self._writer.close()
        try:
            await self._writer.wait_closed()
        except ConnectionError:
            return
