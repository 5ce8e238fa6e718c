"""The Modbus servers of one configuration: plain TCP, TLS and a serial line, all on the same image and desk."""

from collections.abc import Callable, Mapping
from pathlib import Path
from socket import socket

from trueangle.config import ModbusConfig
from trueangle.core.commands import CommandDesk
from trueangle.core.modbus_pdu import Identification, RegisterSource
from trueangle.edges.modbus_server import (
    ModbusCounters,
    ModbusLimits,
    ModbusRtuServer,
    ModbusTcpServer,
    TlsSettings,
    load_tls,
)
from trueangle.edges.modbus_server.server import Listener
from trueangle.edges.modbus_server.tls import is_credential
from trueangle.version import own_version

__all__ = ["ModbusSide", "TlsSettings", "tls_settings", "uses_credentials"]


def uses_credentials(config: ModbusConfig) -> bool:
    """Whether a key or certificate comes from systemd, and can be read only by the service."""
    tls = config.tls
    return tls is not None and any(is_credential(one) for one in (tls.certificate, tls.private_key, tls.client_ca))


def tls_settings(config: ModbusConfig, *, base: Path, credentials: Path | None, source: str) -> TlsSettings | None:
    """Keys and certificates of the configuration; None without TLS, ContractError where they cannot be used."""
    return None if config.tls is None else load_tls(config.tls, base=base, credentials=credentials, source=source)


class ModbusSide:
    """What the service knows of Modbus."""

    def __init__(
        self,
        config: ModbusConfig,
        *,
        image_age_s: float,
        refresh: Callable[[], None],
        tls: TlsSettings | None = None,
        sockets: Mapping[str, socket] | None = None,
    ) -> None:
        """`tls` is that of `tls_settings`; `sockets` are those that systemd handed over, by their names."""
        self._commands = config.commands
        identification = Identification(revision=own_version())
        listener = None
        if config.tls is not None and tls is not None:
            listener = Listener(host=config.tls.host or config.host, port=config.tls.port, tls=tls)
        self.tcp = ModbusTcpServer(
            config.host,
            config.port,
            unit_id=config.unit_id,
            limits=ModbusLimits(
                connections=config.max_connections,
                connections_per_address=config.max_connections_per_address,
                idle_timeout_s=config.idle_timeout_s,
                image_age_s=image_age_s,
                allow=config.networks,
            ),
            refresh=refresh,
            plain=config.plain_tcp,
            tls=listener,
            sockets=sockets,
            plain_commands=config.insecure_commands,
            identification=identification,
        )
        self.rtu: ModbusRtuServer | None = None
        if config.rtu is not None:
            self.rtu = ModbusRtuServer(
                config.rtu, self.tcp.image, identification, commands=config.insecure_commands
            )
        self._needs_tcp = config.plain_tcp or listener is not None

    @property
    def listening(self) -> bool:
        """True while TCP clients can connect; a serial line may be unplugged."""
        return self.tcp.listening or not self._needs_tcp

    @property
    def ports(self) -> Mapping[str, int]:
        """Bound ports by the names of the sockets, while listening."""
        return self.tcp.ports

    @property
    def counters(self) -> ModbusCounters:
        """Of plain TCP and TLS together."""
        return self.tcp.counters

    def take_commands(self, desk: CommandDesk) -> None:
        """Connections from now on give their commands here, where the configuration lets them."""
        if self._commands:
            self.tcp.desk = desk
            if self.rtu is not None:
                self.rtu.desk = desk

    def renew_tls(self, settings: TlsSettings) -> None:
        """Keys, certificates and roles for connections from now on."""
        self.tcp.renew_tls(settings)

    def publish(self, image: RegisterSource) -> None:
        """Answer from this image from now on."""
        self.tcp.publish(image)

    async def start(self) -> None:
        """Listen. Raises LinkError when an address cannot be had."""
        await self.tcp.start()
        if self.rtu is not None:
            self.rtu.start()

    async def close(self) -> None:
        """Stop listening, end all connections, leave the line."""
        if self.rtu is not None:
            self.rtu.close()
        await self.tcp.close()
