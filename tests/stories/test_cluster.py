"""The files of docs/cluster, run on one machine: a stand-in for sbatch, and the containers' commands
as processes.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.helpers.places import ROOT

CLUSTER = ROOT / "docs" / "cluster"
BIN = Path(sys.executable).parent
CAMPAIGN = """[campaign]
aircraft = "espaaro"
mission = "scripts/loiter.xml"
seed = 1
engine = "jsbsim"
[aleatory]
flights = 2
duration_s = 2
burn_in_s = 0
wind_mps = 0
turbulence = "none"
sensor_noise = false
[epistemic]
method = "corners"
interior = 0
coefficients = ["CX", "Cm"]
bounds = { CX = 0.008, Cm = 0.01 }
"""
# Runs the tasks of an array one after the other, as soon as the jobs before it are done.
SBATCH = """#!{python}
import os, re, subprocess, sys
words = sys.argv[1:]
wrapped = [w.partition("=")[2] for w in words if w.startswith("--wrap=")]
after = [w.rpartition(":")[2] for w in words if w.startswith("--dependency=afterok:")]
log = {log!r}
done = open(log).read().split() if os.path.exists(log) else []
assert all(job in done for job in after), (after, done)
job = str(100 + len(done))
if wrapped:
    tasks, command = [0], ["bash", "-c", wrapped[0]]
else:
    script = next(k for k, w in enumerate(words) if not w.startswith("--"))
    text = open(words[script]).read()
    first, last = map(int, re.search(r"#SBATCH --array=(\\d+)-(\\d+)", text).groups())
    cpus = re.search(r"#SBATCH --cpus-per-task=(\\d+)", text).group(1)
    tasks, command = range(first, last + 1), ["bash", *words[script:]]
    os.environ |= {{"SLURM_ARRAY_TASK_COUNT": str(len(tasks)), "SLURM_CPUS_PER_TASK": cpus}}
for task in tasks:
    environment = os.environ | {{"SLURM_ARRAY_TASK_ID": str(task)}}
    subprocess.run(command, env=environment, check=True, stdout=sys.stderr)
open(log, "a").write(job + " ")
print(job)
"""


def path_with_commands() -> dict[str, str]:
    """Return an environment in which uqharness and dask are found."""
    return os.environ | {"PATH": f"{BIN}:{os.environ['PATH']}"}


@pytest.fixture
def single_run(tmp_path: Path) -> pd.DataFrame:
    """Return the cases of one run on this machine; the campaign file is in tmp_path."""
    text = CAMPAIGN.replace('"scripts', f'"{ROOT / "scripts"}')
    (tmp_path / "campaign.toml").write_text(text)
    words = ("campaign", "run", tmp_path / "campaign.toml", "--out", tmp_path / "one", "--serial")
    subprocess.run([BIN / "uqharness", *words], check=True, capture_output=True, cwd=ROOT)
    return pd.read_parquet(tmp_path / "one" / "cases.parquet")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_slurm_shards_make_the_tables_of_one_run(tmp_path, single_run):
    stub = tmp_path / "bin" / "sbatch"
    stub.parent.mkdir()
    stub.write_text(SBATCH.format(python=sys.executable, log=str(tmp_path / "jobs")))
    stub.chmod(0o755)
    environment = path_with_commands()
    environment["PATH"] = f"{stub.parent}:{environment['PATH']}"
    words = (CLUSTER / "submit.sh", tmp_path / "campaign.toml", tmp_path / "out")
    out = subprocess.run(words, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert out.returncode == 0, out.stderr
    assert len(list((tmp_path / "out" / "shards").iterdir())) == 4
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "out" / "cases.parquet"), single_run)
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.skipif(not (BIN / "dask").exists(), reason="needs dask's commands")
def test_the_containers_of_kubernetes_make_the_tables_of_one_run(tmp_path, single_run):
    yaml = pytest.importorskip("yaml")
    documents = list(yaml.safe_load_all((CLUSTER / "kubernetes.yaml").read_text()))
    commands = {
        container["name"]: container["command"]
        for document in documents
        if "template" in document["spec"]
        for container in document["spec"]["template"]["spec"]["containers"]
    }
    # Everybody who may reach the port is a member, and every pod is one.
    templates = [d["spec"]["template"] for d in documents if "template" in d["spec"]]
    labels = [template["metadata"]["labels"] for template in templates]
    assert [label["campaign"] for label in labels] == ["member"] * 3
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])

    def local(command: list[str], *more: str) -> list[str]:
        """Return a container's command with the addresses and paths of this machine."""
        changed = [
            word.replace("campaign-scheduler:8786", f"127.0.0.1:{port}").replace(
                "/campaign/", f"{tmp_path}/"
            )
            for word in command
        ]
        return [port if word == "8786" else word for word in changed] + list(more)

    environment, host = path_with_commands(), ("--host", "127.0.0.1")
    calm = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    processes = [
        subprocess.Popen(local(commands[name], *host), env=environment, **calm)
        for name in ("scheduler", "worker", "worker")
    ]
    try:
        job = local(commands["campaign"])
        out = subprocess.run(
            job, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=900
        )
        assert out.returncode == 0, out.stderr
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()
    pd.testing.assert_frame_equal(
        pd.read_parquet(tmp_path / "results" / "cases.parquet"), single_run
    )
