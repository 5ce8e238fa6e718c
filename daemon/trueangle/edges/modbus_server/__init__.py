"""The Modbus servers: TCP and TLS listeners and a serial line around `core.modbus_answer` and `core.modbus_rtu`.

Rules of this package: pymodbus is met here and nowhere else in the daemon, in `server`. The image is swapped by
reference: an answer is made of one image, whole.
"""

from trueangle.edges.modbus_server.limits import ModbusCounters, ModbusLimits
from trueangle.edges.modbus_server.rtu import ModbusRtuServer
from trueangle.edges.modbus_server.server import ModbusTcpServer
from trueangle.edges.modbus_server.tls import TlsSettings, load_tls

__all__ = [
    "ModbusCounters",
    "ModbusLimits",
    "ModbusRtuServer",
    "ModbusTcpServer",
    "TlsSettings",
    "load_tls",
]
