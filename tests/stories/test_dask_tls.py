"""The recipe of docs/cluster.md for a cluster that nobody else can use: one address, and
certificates.
"""

from __future__ import annotations

import os
import shlex
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

HERE = "127.0.0.1"
BIN = Path(sys.executable).parent

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        shutil.which("openssl") is None or not (BIN / "dask").exists(),
        reason="needs openssl and dask's commands",
    ),
]


def make_certificate(folder: Path, name: str) -> None:
    words = shlex.split(f"req -x509 -newkey rsa:3072 -nodes -days 2 -subj /CN={name}")
    files = ("-keyout", folder / "key.pem", "-out", folder / "cert.pem")
    subprocess.run(["openssl", *words, *files], check=True, capture_output=True)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of everybody who takes part."""
    folder = tmp_path_factory.mktemp("tls")
    make_certificate(folder, "campaign")
    settings = {"REQUIRE_ENCRYPTION": "true", "TLS__CA_FILE": folder / "cert.pem"}
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        settings |= {
            f"TLS__{role}__CERT": folder / "cert.pem",
            f"TLS__{role}__KEY": folder / "key.pem",
        }
    return os.environ | {
        f"DASK_DISTRIBUTED__COMM__{name}": str(value) for name, value in settings.items()
    }


@pytest.fixture(scope="module")
def cluster(certificate: dict[str, str]) -> Iterator[tuple[str, list[int]]]:
    """Address of a scheduler with one worker, and the processes."""
    with socket.socket() as probe:
        probe.bind((HERE, 0))
        port = probe.getsockname()[1]
    address, calm = (
        f"tls://{HERE}:{port}",
        {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL},
    )
    local = ("--host", HERE, "--dashboard-address", f"{HERE}:0")
    words = [
        ["scheduler", "--protocol", "tls", *local, "--port", str(port)],
        ["worker", address, *local, "--nthreads", "1", "--no-nanny"],
    ]
    processes = [
        subprocess.Popen([BIN / "dask", *inputs], env=certificate, cwd=ROOT, **calm)
        for inputs in words
    ]
    try:
        yield address, [process.pid for process in processes]
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def run(address: str, out: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    campaign = ROOT / "tests" / "doc_campaign.toml"
    words = ("--out", out, "--engine", "jsbsim", "--dask", address)
    command = [BIN / "uqharness", "campaign", "run", campaign, *words]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=240
    )


def listens(pids: list[int]) -> set[str]:
    """Addresses (hexadecimal, as /proc has them) on which the processes listen."""
    inodes = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                target = os.readlink(link)
            except OSError:
                continue
            inodes |= {target[8:-1]} if target.startswith("socket:[") else set()
    result = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                result.add(fields[1].partition(":")[0])
    return result


def test_a_campaign_flies_over_tls_on_one_address(cluster, certificate, tmp_path) -> None:
    address, pids = cluster
    done = run(address, tmp_path / "out", certificate)
    assert done.returncode == 0, done.stderr
    assert "32 flights done" in done.stdout
    assert (tmp_path / "out" / "cases.parquet").is_file()
    if Path("/proc/net/tcp").exists():
        assert listens(pids) == {"0100007F"}


def test_without_the_certificate_nobody_answers(cluster, tmp_path) -> None:
    done = run(cluster[0], tmp_path / "out", dict(os.environ))
    assert done.returncode == 2
    assert done.stderr.count("\n") <= 3
    assert "no Dask scheduler answers" in done.stderr
    assert "Traceback" not in done.stderr


def test_another_certificate_is_turned_away(cluster, certificate, tmp_path) -> None:
    make_certificate(tmp_path, "else")
    prefix = "DASK_DISTRIBUTED__COMM__TLS__"
    other = certificate | {
        f"{prefix}CLIENT__CERT": str(tmp_path / "cert.pem"),
        f"{prefix}CLIENT__KEY": str(tmp_path / "key.pem"),
    }
    done = run(cluster[0], tmp_path / "out", other)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
