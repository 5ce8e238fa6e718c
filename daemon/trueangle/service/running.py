"""The service: a Modbus server, the arrangement in force behind it, and what systemd is told of both.

Data flow: CAN bus -> pipeline -> register image -> Modbus server; what is not process data goes to the CANopen
master. The watchdog is fed where an image is published and nowhere else, so a pipeline that stands still is seen
by systemd. SIGHUP: configuration and models are loaded and checked in a thread while everything goes on, then
swapped in between two cycles; what is refused changes nothing.
"""

import asyncio
import datetime
import gc
import logging
import signal
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from socket import socket
from types import TracebackType

from trueangle.config import DaemonConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.calendar_day import LatestDay
from trueangle.core.health import ServiceBit
from trueangle.core.metrics import CONTENT_TYPE, render_metrics
from trueangle.core.registers import RegisterImage
from trueangle.edges.metrics import MetricsServer
from trueangle.edges.modbus_server import TlsSettings
from trueangle.edges.systemd import ServiceNotifier
from trueangle.service.arrangement import Arrangement
from trueangle.service.bus_line import BusLine
from trueangle.service.commanding import Commanding
from trueangle.service.joints import Loaded, LoadedJoint
from trueangle.service.measuring import service_samples
from trueangle.service.modbus_side import ModbusSide
from trueangle.service.recording import recorded_joints, recorder_of
from trueangle.service.reloading import ReloadRecord, restart_faults

TICK_S = 0.01
"""Ages in the registers are renewed at least this often, and a joint gone stale is marked within it."""
IMAGE_AGE_S = 3 * TICK_S
"""No image older than this is served: after a stall the joints are judged anew before the first answer, and a
pipeline that stands still does not leave its last angle valid."""
STATUS_TEXT_S = 1.0

_log = logging.getLogger(__name__)


class Service:
    """The running daemon; `run` returns after a signal or `stop`."""

    def __init__(
        self,
        config: DaemonConfig,
        joints: tuple[LoadedJoint, ...],
        notifier: ServiceNotifier,
        *,
        load_again: Callable[[], Loaded] | None = None,
        sockets: Mapping[str, socket] | None = None,
        state_directory: Path | None = None,
        load_tls: Callable[[], TlsSettings | None] = lambda: None,
    ) -> None:
        """`load_again` is called in a worker thread at each SIGHUP; ContractError refuses. None: no reload.

        `sockets`: already bound, by the names of the socket units. `state_directory`: where presets are kept;
        None: nowhere. `load_tls` reads keys and certificates, now and at each reload. ContractError where presets
        or certificates cannot be read.
        """
        self._notifier = notifier
        self._sockets = dict(sockets or {})
        self.state_directory = state_directory
        self._commanding: Commanding | None = None
        self._load_tls = load_tls
        self._renewed_tls: TlsSettings | None = None
        self._server = ModbusSide(
            config.modbus,
            image_age_s=IMAGE_AGE_S,
            refresh=lambda: self._arrangement.pipeline.tick(time.monotonic_ns()),
            tls=load_tls(),
            sockets=self._sockets,
        )
        self.recorder = recorder_of(config)
        """None where nothing is to be recorded."""
        self._today = LatestDay(lambda: datetime.datetime.now(datetime.UTC).date())
        self._arrangement = self._arranged(Loaded(config=config, joints=joints))
        self._lines: dict[str, BusLine] = {}
        self._leaving: list[BusLine] = []
        """Detached lines that are not closed yet."""
        self._load_again = load_again
        self._reload_asked = False
        self.reloads = ReloadRecord()
        self._fed_ns = 0
        self._status_ns = 0
        self._ready = False
        """READY was said once: the watchdog counts from then on."""
        self._ready_owed = True
        self._stopping = False
        self._wake = asyncio.Event()
        """A stop or a reload was asked for, or the loading has ended."""
        if state_directory is not None:
            self._commanding = Commanding(
                state_directory,
                arrangement=lambda: self._arrangement,
                ask_again=self._on_clash,
                note_reference=self._note_reference,
            )
            self._server.take_commands(self._commanding.desk)
        elif config.modbus.commands:
            expected = "a state_directory, where presets are kept"
            raise ContractError([Fault(where="modbus.commands", expected=expected, found="none")])

    def _note_reference(self, slot: int, reference_deg: float) -> None:
        if self.recorder is not None:
            self.recorder.note_reference(slot, reference_deg)

    def stop(self) -> None:
        """Ask for an orderly stop."""
        self._stopping = True
        self._wake.set()

    def reload(self) -> None:
        """Ask for a reload; while one is on its way, one more is remembered."""
        if self._load_again is None:
            _log.warning("event=reload_ignored reason='restart to reload'")
            return
        self._reload_asked = True
        self._wake.set()

    async def run(self) -> None:
        """Serve until stopped. Raises LinkError where the Modbus port cannot be had."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        # The default would end the process at once, in the middle of whatever it does.
        loop.add_signal_handler(signal.SIGHUP, self.reload)
        try:
            async with AsyncExitStack() as stack:
                if self.recorder is not None:
                    stack.enter_context(self.recorder)
                if self._commanding is not None:
                    stack.push_async_callback(self._commanding.close)
                await self._server.start()
                self._close_unused()
                stack.push_async_callback(self._server.close)
                if (metrics := self._metrics(self._arrangement.config)) is not None:
                    await metrics.open()
                    stack.push_async_callback(metrics.close)
                _tell_unbound(self._arrangement.joints.values())
                stack.push_async_exit(self._close_lines)
                await self._open_lines()
                # Once more, to come before the buses: while they close, the last image would pass for fresh.
                stack.push_async_callback(self._server.close)
                stack.callback(self._notifier.stopping)
                async with asyncio.TaskGroup() as tasks:
                    ticking = tasks.create_task(self._tick())
                    try:
                        await self._until_stopped(tasks)
                    finally:
                        ticking.cancel()
        finally:
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                loop.remove_signal_handler(number)
        _log.info("event=stopped images=%d", self._arrangement.pipeline.counters.images)

    def _metrics(self, config: DaemonConfig) -> MetricsServer | None:
        if config.metrics is None:
            return None
        started_s = time.time()

        def render() -> str:
            return render_metrics(
                service_samples(
                    self._arrangement,
                    self._lines,
                    self._server.counters,
                    self.reloads,
                    now_ns=time.monotonic_ns(),
                    started_s=started_s,
                )
            )

        return MetricsServer(config.metrics.host, config.metrics.port, render=render, content_type=CONTENT_TYPE)

    def _close_unused(self) -> None:
        """A socket that nobody answers on would let its clients wait for ever: they are refused instead."""
        for name, handed_over in self._sockets.items():
            if name not in self._server.ports:
                _log.warning("event=socket_unused name=%r reason='no server of this name is configured'", name)
                handed_over.close()

    async def _open_lines(self) -> None:
        """Open the buses of the arrangement that are not open."""
        for settings in self._arrangement.config.buses:
            if settings.name not in self._lines:
                line = self._lines[settings.name] = BusLine(settings, self._arrangement)
                await line.__aenter__()

    async def _close_lines(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        stack = AsyncExitStack()
        for line in (*self._leaving, *self._lines.values()):
            stack.push_async_exit(line)
        await stack.__aexit__(kind, error, trace)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            now_ns = time.monotonic_ns()
            arrangement = self._arrangement
            arrangement.pipeline.service_bits = self._service_bits(now_ns)
            last_ns = arrangement.pipeline.last_image_ns
            if last_ns is None or now_ns - last_ns >= TICK_S * 1e9:
                arrangement.pipeline.tick(now_ns)
            arrangement.tick(now_ns)
            self._tell_systemd(now_ns)

    def _service_bits(self, now_ns: int) -> ServiceBit:
        bits = ServiceBit.RELOAD_REFUSED if self.reloads.refusal else ServiceBit(0)
        if self._arrangement.config.modbus.commands:
            bits |= ServiceBit.COMMANDS_ENABLED
        for line in self._lines.values():
            bits |= line.service_bits(now_ns)
        if self.recorder is not None and self.recorder.stopped:
            bits |= ServiceBit.RECORDER_STOPPED
        return bits

    async def _until_stopped(self, tasks: asyncio.TaskGroup) -> None:
        loading: asyncio.Task[Arrangement | list[str]] | None = None
        try:
            while not self._stopping:
                self._wake.clear()
                if loading is not None and loading.done():
                    await self._conclude(loading.result())
                    loading = None
                if loading is None and self._reload_asked:
                    self._reload_asked = False
                    loading = tasks.create_task(self._load())
                    loading.add_done_callback(lambda _: self._wake.set())
                if not self._stopping:
                    await self._wake.wait()
        finally:
            if loading is not None:
                loading.cancel()

    async def _load(self) -> Arrangement | list[str]:
        """What the files hold now, or why it is refused. The loop goes on meanwhile."""
        self._notifier.reloading(time.monotonic_ns() // 1000)
        self.reloads.begin(time.monotonic_ns())
        _log.info("event=reload_begun")
        try:
            return await asyncio.to_thread(self._arrange_again, self._arrangement.config)
        except ContractError as error:
            return [str(fault) for fault in error.faults]
        except Exception as error:  # noqa: BLE001 - whatever a new file may do, the old arrangement goes on
            return [f"{type(error).__name__}: {error}"]

    def _arrange_again(self, running: DaemonConfig) -> Arrangement:
        """In a worker thread: load, check, and build all that the swap needs."""
        assert self._load_again is not None  # noqa: S101 - `reload` has looked
        loaded = self._load_again()
        if faults := restart_faults(running, loaded.config):
            raise ContractError(faults)
        self._renewed_tls = self._load_tls()
        return self._arranged(loaded)

    def _arranged(self, loaded: Loaded) -> Arrangement:
        return Arrangement(
            loaded,
            publish=self._publish,
            on_clash=self._on_clash,
            today=self._today,
            on_accepted=self._on_accepted,
        )

    def _on_accepted(self, slot: int, settings: EncoderSettings) -> None:
        if self._commanding is not None:
            self._commanding.accepted(slot, settings)

    def _on_clash(self, bus: str, node_id: int, reason: str) -> None:
        if bus in self._lines:
            self._lines[bus].distrust_node(node_id, reason)

    async def _conclude(self, loaded: Arrangement | list[str]) -> None:
        if isinstance(loaded, Arrangement):
            await self._swap(loaded)
        else:
            self.reloads.refuse(loaded)
        now_ns = time.monotonic_ns()
        self._arrangement.pipeline.service_bits = self._service_bits(now_ns)
        self._arrangement.pipeline.tick(now_ns)
        self._ready_owed = True

    async def _swap(self, new: Arrangement) -> None:
        """The new arrangement in place of the old; no frame and no request comes between until the first await."""
        old = self._arrangement
        settings = {bus.name: bus for bus in new.config.buses}
        staying = {name: line for name, line in self._lines.items() if settings.get(name) == line.settings}
        kept = new.take_over(old, {name: line.up for name, line in staying.items()})
        for name, line in self._lines.items():
            if name in staying:
                line.rearrange(new, kept.nodes)
            else:
                line.detach()
                self._leaving.append(line)
        self._arrangement, self._lines = new, staying
        if self.recorder is not None:
            self.recorder.joints = recorded_joints(new.config)
        if self._commanding is not None:
            self._commanding.rearranged(kept.slots)
        if self._renewed_tls is not None:
            self._server.renew_tls(self._renewed_tls)
        new.pipeline.tick(time.monotonic_ns())
        _tell_unbound(joint for slot, joint in new.joints.items() if slot not in kept.slots)
        # One channel may be the old bus and the new one: closed first.
        while self._leaving:
            await self._leaving[0].__aexit__(None, None, None)
            self._leaving.pop(0)
        await self._open_lines()
        gone = sorted(old.joints.keys() - new.joints.keys())
        del old
        # What was replaced lies in cycles (a pipeline calls its arrangement). The collector counts objects and
        # knows nothing of the memory that ONNX Runtime keeps behind a few, so by itself it would come too seldom.
        gc.collect()
        self.reloads.done(
            time.monotonic_ns(), kept=len(kept.slots), anew=len(new.joints) - len(kept.slots), gone=gone
        )

    def _publish(self, image: RegisterImage) -> None:
        self._server.publish(image)
        if self.recorder is not None:
            self.recorder.offer(image, time.monotonic_ns())
        interval_s = self._notifier.watchdog_interval_s
        if interval_s is not None and self._ready:
            now_ns = time.monotonic_ns()
            if now_ns - self._fed_ns >= interval_s * 1e9 and self._server.listening:
                self._fed_ns = now_ns
                self._notifier.alive()

    def _tell_systemd(self, now_ns: int) -> None:
        if self._ready_owed and not self.reloads.running and self._arrangement.decided(now_ns):
            text = self.status_text()
            if not self._ready:
                _log.info("event=ready status=%r", text)
            self._ready, self._ready_owed = True, False
            self._notifier.ready(text)
        elif now_ns - self._status_ns >= STATUS_TEXT_S * 1e9:
            self._status_ns = now_ns
            self._notifier.status(self.status_text())

    def status_text(self) -> str:
        """One line: how many joints are valid, what the others suffer from, why a reload was refused."""
        text = self._arrangement.status_text()
        return f"{text}; {self.reloads.refusal}" if self.reloads.refusal else text


def _tell_unbound(joints: Iterable[LoadedJoint]) -> None:
    """A model without a serial number fits every encoder of its kind: said once for each."""
    for joint in joints:
        if joint.model.metadata.encoder_settings.serial_number is None:
            _log.warning("event=model_not_bound joint=%r model=%s", joint.config.name, joint.config.model)
