"""Reloads: what a running service cannot take on, and the account of those that were tried."""

import logging
from dataclasses import fields, is_dataclass

from trueangle.config import DaemonConfig
from trueangle.contract.errors import Fault

RELOADABLE = frozenset({"buses", "joints"})
"""Keys at the top of the configuration that may change while the service runs."""
MAX_LOGGED_FAULTS = 20

_log = logging.getLogger(__name__)


def restart_faults(running: DaemonConfig, found: DaemonConfig) -> list[Fault]:
    """One fault for each key that differs and cannot change while PLCs are connected."""
    faults: list[Fault] = []
    for item in fields(DaemonConfig):
        if item.name not in RELOADABLE:
            faults += _differences(item.name, getattr(running, item.name), getattr(found, item.name))
    return faults


def _differences(where: str, running: object, found: object) -> list[Fault]:
    """By key, down to the values that differ."""
    if running == found:
        return []
    if is_dataclass(running) and type(running) is type(found):
        return [
            fault
            for item in fields(running)
            for fault in _differences(
                f"{where}.{item.name}", getattr(running, item.name), getattr(found, item.name)
            )
        ]
    advice = "restart the service for this key: systemctl restart trueangled"
    return [Fault(where=where, expected=f"{_shown(running)} as at the start", found=_shown(found), advice=advice)]


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    return str(value)


class ReloadRecord:
    """What became of the reloads so far."""

    def __init__(self) -> None:
        self.succeeded = 0
        self.refused = 0
        self.running = False
        """The files are being loaded, or the swap is on its way."""
        self.refusal = ""
        """Why the last one was refused; empty after one that was not."""
        self._begun_ns = 0

    def begin(self, now_ns: int) -> None:
        """SIGHUP was heard."""
        self._begun_ns = now_ns
        self.running = True

    def refuse(self, faults: list[str]) -> None:
        """Nothing changes; every fault is a line."""
        self.running = False
        self.refused += 1
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        self.refusal = f"reload refused: {faults[0]}{more}"
        for number, fault in enumerate(faults[:MAX_LOGGED_FAULTS], start=1):
            _log.error("event=reload_refused fault=%d of=%d reason=%r", number, len(faults), fault)

    def done(self, now_ns: int, *, kept: int, anew: int, gone: list[int]) -> None:
        """The new arrangement is in force."""
        self.running = False
        self.succeeded += 1
        self.refusal = ""
        took_s = (now_ns - self._begun_ns) * 1e-9
        slots = ",".join(map(str, gone)) or "none"
        _log.info("event=reloaded kept=%d anew=%d slots_gone=%s took_s=%.3f", kept, anew, slots, took_s)
