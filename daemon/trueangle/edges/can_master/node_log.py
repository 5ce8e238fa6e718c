"""What the log says of one node: one line where a trouble begins, one where it ends, however often it repeats."""

import logging
import time

from trueangle.core.frames import NodePlan
from trueangle.core.node_setup import NodeReport, NodeState

EMERGENCY, OTHER_MASTER = "EMCY", "another master"
MOST_KINDS = 32
"""A node that finds ever new ways to fail fills neither log nor memory."""

_log = logging.getLogger(__name__)


class NodeLog:
    """A latch: each way in which a node fails is one line in an outage, its emergencies are counted."""

    def __init__(self, plan: NodePlan) -> None:
        self._node = f"slot={plan.slot or 'none'} node_id={plan.node_id}"
        self._failed: set[str] = set()
        """The ways in which it failed since it was last in service."""
        self._out_since_s = time.monotonic()
        self.emergencies = 0
        """EMCY messages since the node was last in service."""
        self._other_since_s: float | None = None
        """Since when another master asks the node; None: none does."""
        self._other_last_s = 0.0
        self._other_requests = 0

    def other_master(self, address: str, now_s: float) -> None:
        """Another master asks the node for this object, or writes it."""
        if self._other_since_s is None:
            self._other_since_s, self._other_requests = now_s, 0
            _log.warning(
                "event=other_master_begins %s object=%s reason='SDO requests that are not ours'",
                self._node, address,
            )  # fmt: skip
        self._other_last_s = now_s
        self._other_requests += 1

    def tick(self, now_s: float, quiet_s: float) -> None:
        """What is due although nothing changed."""
        if self._other_since_s is not None and now_s - self._other_last_s >= quiet_s:
            lasted_s = self._other_last_s - self._other_since_s
            self._other_since_s = None
            _log.info(
                "event=other_master_ends %s requests=%d lasted_s=%.1f", self._node, self._other_requests, lasted_s
            )

    def tell(self, report: NodeReport, failures: int) -> None:
        """Log this report where it says something new."""
        node = f"event=node_{report.state.value} {self._node}"
        if report.in_service:
            out_s = time.monotonic() - self._out_since_s
            _log.info(
                "%s attempts=%d out_s=%.1f emergencies=%d reason=%r",
                node, failures + 1, out_s, self.emergencies, report.reason,
            )  # fmt: skip
            self._failed.clear()
            self.emergencies = 0
        elif report.state in (NodeState.LOST, NodeState.FAULT, NodeState.CLASH):
            if not self._failed:
                self._out_since_s = time.monotonic()
            # In a storm each EMCY differs in its last bytes, each write in its object: the first speaks for all.
            kind = next((k for k in (EMERGENCY, OTHER_MASTER) if report.reason.startswith(k)), report.reason)
            if kind not in self._failed and len(self._failed) < MOST_KINDS:
                self._failed.add(kind)
                _log.warning("%s reason=%r", node, report.reason)
        elif failures == 0:
            _log.info("%s", node)
