"""Errors of the running daemon, beside those it shares with the laboratory; the type says what to do."""

from trueangle.contract.errors import TrueangleError


class LinkError(TrueangleError):
    """The way to a device is gone (bus, socket, silent node): degrade and try again with back-off."""


class NodeSilent(LinkError):
    """A node, or its bus, fell silent: nothing speaks against what it said before."""


class NodeFault(TrueangleError):
    """A node answers, but not as it must: its joint is taken out of service and the node set up again."""


class NodeClash(NodeFault):
    """Two nodes answer to one node-id: whose frame is whose is unknown, so neither is believed."""
