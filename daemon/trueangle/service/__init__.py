"""The composition root: configuration and models in, a running service out.

`joints` makes frozen values of configuration and models; `arrangement` is one configuration in force, `bus_line` a
bus that may outlive it; `running` holds the server, the arrangement in force and what the outside is told.
"""

from trueangle.service.arrangement import reasons
from trueangle.service.joints import (
    Loaded,
    LoadedJoint,
    check_buses,
    encoder_differences,
    joint_channel,
    joint_identity,
    load,
    load_joints,
    node_plan,
    state_directory,
)
from trueangle.service.running import IMAGE_AGE_S, TICK_S, Service

__all__ = [
    "IMAGE_AGE_S",
    "TICK_S",
    "Loaded",
    "LoadedJoint",
    "Service",
    "check_buses",
    "encoder_differences",
    "joint_channel",
    "joint_identity",
    "load",
    "load_joints",
    "node_plan",
    "reasons",
    "state_directory",
]
