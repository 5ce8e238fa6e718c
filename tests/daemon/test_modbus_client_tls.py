"""The commands for people against a service that answers TLS alone, and peers that are not what they say."""

import asyncio
import ssl
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.fakes.certificates import Authority, Identity
from tests.fakes.register_server import RegisterServer
from tests.fakes.running_service import config_yaml, joint_yaml
from tests.fakes.served_images import image_of
from tests.fakes.trueangled_process import trueangled


@dataclass(frozen=True)
class Plant:
    """An authority, the server's and a reader's identity, and those of somebody else."""

    authority: Authority
    server: Identity
    reader: Identity
    foreign: Authority
    stranger: Identity


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    directory = tmp_path_factory.mktemp("keys")
    ours, theirs = Authority(directory, "plant"), Authority(directory, "foreign")
    return Plant(
        ours,
        ours.issue("arm", "subjectAltName=IP:127.0.0.1,DNS:arm.plant"),
        ours.with_role("reader", "viewer"),
        theirs,
        theirs.with_role("stranger", "viewer"),
    )


def shown(authority: Authority, identity: Identity) -> list[str]:
    return [
        "--ca",
        str(authority.certificate),
        "--certificate",
        str(identity.certificate),
        "--key",
        str(identity.key),
    ]


def asked(plant: Plant, *arguments: str, exception: int = 0) -> tuple[int, str, str]:
    """A command against a server with mutual TLS; exit code, stdout, stderr."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_cert_chain(plant.server.certificate, plant.server.key)
    context.load_verify_locations(plant.authority.certificate)

    async def scenario() -> tuple[int, str, str]:
        async with RegisterServer(image_of({1: None}), context) as server:
            server.exception = exception
            asyncio.get_running_loop().set_exception_handler(lambda *_: None)
            done = await asyncio.to_thread(trueangled, *arguments, "--port", str(server.port))
            return done.returncode, done.stdout, done.stderr

    return asyncio.run(scenario())


@pytest.mark.parametrize("by_name", [False, True])
def test_monitor_reads_a_service_that_answers_tls_alone(plant: Plant, by_name: bool) -> None:
    name = ["--server-name", "arm.plant"] if by_name else []
    code, out, err = asked(plant, "monitor", "--once", *shown(plant.authority, plant.reader), *name)
    assert (code, err) == (0, "")
    assert "all 1 joints valid" in out


def test_record_reads_it_too(plant: Plant, tmp_path: Path) -> None:
    arguments = ("record", "--out", str(tmp_path), "--for", "0.3", *shown(plant.authority, plant.reader))
    code, out, err = asked(plant, *arguments)
    assert (code, err) == (0, "")
    assert "rows recorded" in out
    assert len(list(tmp_path.glob("*.csv"))) == 1


@pytest.mark.parametrize("case", ["stranger", "foreign server", "other name", "plain"])
def test_a_peer_that_is_not_accepted_is_one_line_that_says_which(plant: Plant, case: str) -> None:
    options, expected = {
        "stranger": (shown(plant.authority, plant.stranger), "; is our certificate accepted there, "),
        "foreign server": (shown(plant.foreign, plant.reader), "the server's certificate is not accepted: "),
        "other name": (
            [*shown(plant.authority, plant.reader), "--server-name", "leg.plant"],
            "the server's certificate is not accepted: Hostname mismatch",
        ),
        "plain": ([], "connection lost: "),
    }[case]
    code, out, err = asked(plant, "monitor", "--once", *options)
    assert (code, out) == (1, "")
    assert expected in err
    assert len(err.splitlines()) == 1
    assert "_ssl.c" not in err


def test_keys_that_cannot_be_used_are_told_with_their_files(plant: Plant, tmp_path: Path) -> None:
    absent = str(tmp_path / "absent.pem")
    done = trueangled("monitor", "--once", "--ca", absent, "--certificate", absent, "--key", absent)
    assert done.returncode == 2
    assert done.stderr.count("No such file or directory") == 2
    mixed = ["--certificate", str(plant.reader.certificate), "--key", str(plant.stranger.key)]
    done = trueangled("monitor", "--once", "--ca", str(plant.authority.certificate), *mixed)
    assert done.returncode == 2
    assert (
        "expected a PEM certificate and its own key, not encrypted, found TLS: key values mismatch" in done.stderr
    )


def test_half_of_the_options_and_none_where_they_are_needed_say_what_is_missing(tmp_path: Path) -> None:
    done = trueangled("monitor", "--once", "--ca", "x.pem")
    assert done.returncode == 2
    assert "expected --ca, --certificate and --key together, found no --certificate, --key" in done.stderr
    path = tmp_path / "tls.yaml"
    tls = "{plain_tcp: false, tls: {certificate: c, private_key: k, client_ca: a}}"
    path.write_text(config_yaml(joint_yaml(1, "base")).replace("{port: 0}", tls), "utf-8")
    done = trueangled("monitor", "--once", "--config", str(path))
    assert done.returncode == 2
    assert "expected --ca, --certificate, --key for a service that answers TLS alone" in done.stderr
