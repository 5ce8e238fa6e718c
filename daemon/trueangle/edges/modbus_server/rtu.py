"""The Modbus RTU server: a serial line around `core.modbus_rtu`, opened again when it is lost."""

import asyncio
import fcntl
import logging
import os
import termios
import time
from collections.abc import Callable

from trueangle.config import Parity, RtuConfig
from trueangle.core.bus import backoff_s
from trueangle.core.commands import CommandDesk, Peer
from trueangle.core.modbus_pdu import Identification, PduResponder, RegisterSource
from trueangle.core.modbus_rtu import ModbusRtuStream
from trueangle.errors import LinkError

FIRST_BACKOFF_S, LIMIT_BACKOFF_S = 0.2, 5.0

_LOG = logging.getLogger(__name__)
_READ_BYTES = 4096
_CONTROL, _INPUT_SPEED, _OUTPUT_SPEED = 2, 4, 5
"""Places in the list that `termios.tcgetattr` gives."""


class ModbusRtuServer:
    """Serves the image on one serial line; all methods run on the loop."""

    def __init__(
        self,
        config: RtuConfig,
        image: Callable[[int], RegisterSource | None],
        identification: Identification,
        *,
        desk: CommandDesk | None = None,
        commands: bool = False,
    ) -> None:
        """`commands`: whoever is on the line may give them, as a serial line knows no roles."""
        self._config = config
        self._image = image
        self._identification = identification
        self.desk = desk
        """Taken up when the line is started."""
        self._commands = commands
        self._descriptor: int | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._attempt = 0
        self._running = False
        self._lost_s: float | None = None
        self._responder: PduResponder | None = None
        self._stream = self._new_stream()

    @property
    def stream(self) -> ModbusRtuStream:
        """Its counters are the line's."""
        return self._stream

    @property
    def listening(self) -> bool:
        """True while the line is open."""
        return self._descriptor is not None

    def start(self) -> None:
        """Open the line, now or as soon as the device is there: an adapter may be plugged in later."""
        self._running = True
        self._stream = self._new_stream()
        self._open()

    def close(self) -> None:
        """Leave the line."""
        self._running = False
        self._let_go()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _new_stream(self) -> ModbusRtuStream:
        config = self._config
        peer = Peer(address=config.device, may_command=self._commands)
        session = self.desk.session(peer) if self.desk is not None and self._commands else None
        self._responder = PduResponder(self._identification, peer=peer, session=session)
        longer_ns = None if config.silence_ms is None else round(config.silence_ms * 1e6)
        return ModbusRtuStream(
            config.unit_id, self._responder, baudrate=config.baudrate, longer_silence_ns=longer_ns
        )

    def _open(self) -> None:
        config = self._config
        try:
            self._descriptor = open_serial(config)
        except LinkError as error:
            self._lost(str(error))
            return
        asyncio.get_running_loop().add_reader(self._descriptor, self._read)
        _LOG.info("event=modbus_rtu_open device=%s baudrate=%d", config.device, config.baudrate)
        self._attempt, self._lost_s = 0, None

    def _read(self) -> None:
        if self._descriptor is None:
            return
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not data:
            self._lost("the device hung up")
            return
        self._stream.receive(data, time.monotonic_ns())
        if self._timer is not None:
            self._timer.cancel()
        self._wait_for_silence()

    def _wait_for_silence(self) -> None:
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._stream.silence_ns * 1e-9, self._silent)

    def _silent(self) -> None:
        self._timer = None
        if self._descriptor is None:
            return
        now_ns = time.monotonic_ns()
        answer = self._stream.silent(self._image(now_ns), now_ns)
        if not answer:
            return
        try:
            sent = os.write(self._descriptor, answer)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if sent < len(answer):
            # Half an answer is damaged for the master; the rest must not come in front of the next one.
            termios.tcflush(self._descriptor, termios.TCOFLUSH)

    def _lost(self, reason: str) -> None:
        """The device is not there: logged once, tried again with growing pauses."""
        self._let_go()
        loop = asyncio.get_running_loop()
        if self._lost_s is None:
            self._lost_s = loop.time()
            _LOG.warning("event=modbus_rtu_lost device=%s reason=%r", self._config.device, reason)
        if self._running:
            self._attempt += 1
            pause_s = backoff_s(self._attempt, FIRST_BACKOFF_S, LIMIT_BACKOFF_S)
            self._timer = loop.call_later(pause_s, self._open)

    def _let_go(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._responder is not None:
            self._responder.close()
        if self._descriptor is not None:
            asyncio.get_running_loop().remove_reader(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = None


def open_serial(config: RtuConfig) -> int:
    """A descriptor of the raw line, for this process alone; LinkError where it cannot be had."""
    try:
        descriptor = os.open(config.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise _no_line(config, error.strerror or str(error)) from error
    try:
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
        attributes = termios.tcgetattr(descriptor)
        speed = getattr(termios, f"B{config.baudrate}")
        control = termios.CS8 | termios.CREAD | termios.CLOCAL
        if config.stop_bits == 2:
            control |= termios.CSTOPB
        # A character with wrong parity is read as 0, so the CRC refuses the frame.
        checked = 0
        if config.parity is not Parity.NONE:
            control |= termios.PARENB | (termios.PARODD if config.parity is Parity.ODD else 0)
            checked = termios.INPCK
        attributes[: _CONTROL + 2] = [checked, 0, control, 0]
        attributes[_INPUT_SPEED] = attributes[_OUTPUT_SPEED] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        os.close(descriptor)
        raise _no_line(config, str(error.args[-1])) from error
    return descriptor


def _no_line(config: RtuConfig, reason: str) -> LinkError:
    return LinkError(
        f"modbus.rtu: expected the serial line {config.device}, got {reason}; "
        "try ls /dev/serial/by-id, and DeviceAllow= and a group in the unit"
    )
