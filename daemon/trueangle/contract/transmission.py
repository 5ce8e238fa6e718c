"""How process data come to be sent (CiA 301, TPDO transmission types)."""

import enum


class Trigger(enum.Enum):
    """What makes a node send a TPDO."""

    SYNC = "sync"
    TIMER = "timer"
    """Its own event timer."""
    EVENT = "event"
    """A change of the value, and the event timer where nothing changes."""
