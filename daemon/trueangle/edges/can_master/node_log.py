"""What the log says of one node: one line where a trouble begins, one where it ends, however often it repeats."""

import logging
import time

from trueangle.core.frames import NodePlan
from trueangle.core.node_setup import NodeReport, NodeState

EMERGENCY = "EMCY"
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

    def tell(self, report: NodeReport, failures: int) -> None:
        """Log this report where it says something new."""
        node = f"{self._node} state={report.state.value}"
        if report.in_service:
            out_s = time.monotonic() - self._out_since_s
            _log.info(
                "node %s attempts=%d out_s=%.1f emergencies=%d reason=%r",
                node, failures + 1, out_s, self.emergencies, report.reason,
            )  # fmt: skip
            self._failed.clear()
            self.emergencies = 0
        elif report.state in (NodeState.LOST, NodeState.FAULT, NodeState.CLASH):
            if not self._failed:
                self._out_since_s = time.monotonic()
            # In a storm each EMCY differs in its last bytes: the first speaks for all.
            kind = EMERGENCY if report.reason.startswith(EMERGENCY) else report.reason
            if kind not in self._failed and len(self._failed) < MOST_KINDS:
                self._failed.add(kind)
                _log.warning("node %s reason=%r", node, report.reason)
        elif failures == 0:
            _log.info("node %s", node)
