"""Only the user who started a local cluster can connect to its processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from typing import Any

import psutil
import pytest

from cornercase._common.errors import InputError
from cornercase._common.process import dask

distributed = pytest.importorskip("distributed")

# Tries each address with each method, like another user's program, and prints what answered.
_STRANGER = """
import asyncio, json, sys
from distributed.core import rpc
from distributed.security import Security
from urllib.request import urlopen

async def asked(address, means):
    try:
        async with rpc(address, connection_args=means.get_connection_args("client"), timeout=3) as server:
            await asyncio.wait_for(server.identity(), 3)
    except (OSError, TimeoutError, asyncio.TimeoutError, RuntimeError, TypeError):
        return None
    return address

def read(port):
    try:
        urlopen(f"http://127.0.0.1:{port}/health", timeout=3).read()
    except (OSError, ValueError):
        return None
    return f"http://127.0.0.1:{port}"

async def main(ports):
    other = Security.temporary()
    tries = [asked(f"tcp://127.0.0.1:{one}", Security()) for one in ports]
    tries += [asked(f"tls://127.0.0.1:{one}", other) for one in ports]
    tries += [asyncio.to_thread(read, one) for one in ports]
    print(json.dumps([one for one in await asyncio.gather(*tries) if one]))

asyncio.run(main(json.loads(sys.argv[1])))
"""


# Other tests of this process may listen too.
_BEFORE: set[int] = set()


@pytest.fixture(scope="module")
def client():
    _BEFORE.update(one.port for one in listening())
    with dask.open_connection("local", 2) as made:
        yield made


def listening() -> list[Any]:
    """Addresses at which this process and its children listen."""
    me = psutil.Process()
    processes = [me, *me.children(recursive=True)]
    found = []
    for each in processes:
        # Processes of other tests may end meanwhile.
        with suppress(psutil.NoSuchProcess):
            found += [one.laddr for one in each.net_connections() if one.status == psutil.CONN_LISTEN]
    return [one for one in found if one.port not in _BEFORE]


def test_42_s4_nobody_else_can_connect_to_a_local_cluster(client):
    addresses = listening()
    # The scheduler, and two workers with their nannies.
    assert len(addresses) >= 5
    assert {one.ip for one in addresses} == {"127.0.0.1"}
    ports = json.dumps([one.port for one in addresses])
    done = subprocess.run([sys.executable, "-c", _STRANGER, ports], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr

    async def each() -> list[Any]:
        given = client.security.get_connection_args("client")
        servers = [distributed.core.rpc(f"tls://127.0.0.1:{one.port}", connection_args=given) for one in addresses]
        return [(await server.identity())["type"] for server in servers]

    # Make sure that only the stranger is refused.
    assert sorted(client.sync(each)) == sorted(["LocalScheduler", *2 * ["ReapedNanny", "LocalWorker"]])
    assert client.submit(os.getpid).result() != os.getpid()


def test_42_s4_a_stranger_runs_no_code_in_it(client, tmp_path):
    address, harm = client.scheduler.address, tmp_path / "harm"
    code = f"import distributed; distributed.Client({{!r}}, timeout=3).submit(open, {str(harm)!r}, 'w').result(10)"
    for one in (address, address.replace("tls", "tcp")):
        done = subprocess.run([sys.executable, "-c", code.format(one)], capture_output=True, timeout=300)
        assert done.returncode == 1
        assert not harm.exists()


def test_42_s4_without_what_makes_certificates_the_extra_is_named(monkeypatch):
    def missing(**_: object) -> None:
        raise ImportError("no cryptography")

    monkeypatch.setattr(distributed.security.Security, "temporary", missing)
    with pytest.raises(InputError, match=r"needs the package cryptography, .*cornercase\[cluster\]"):
        dask.connect("local")


@pytest.mark.slow
def test_a_cluster_of_ones_own_can_be_closed(client, tmp_path):
    """As in docs/cluster.md: with certificates from Dask's settings."""
    names = {
        "ca_file": client.security.tls_ca_file,
        "cert": client.security.tls_client_cert,
        "key": client.security.tls_client_key,
    }
    for name, content in names.items():
        (tmp_path / f"{name}.pem").write_text(content)
    settings = {f"DASK_DISTRIBUTED__COMM__TLS__{one.upper()}": str(tmp_path / f"{one}.pem") for one in ("ca_file",)}
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        for one in ("cert", "key"):
            settings[f"DASK_DISTRIBUTED__COMM__TLS__{role}__{one.upper()}"] = str(tmp_path / f"{one}.pem")
    code = (
        "import sys\nfrom cornercase._common.process.dask import connected\n"
        "with connected(sys.argv[1]) as client:\n    print(client.submit(pow, 2, 3).result())\n"
    )
    command = [sys.executable, "-c", code, client.scheduler.address]
    closed = {**os.environ, **settings}
    for given, expected in ((closed, (0, "8\n")), (dict(os.environ), (1, ""))):
        done = subprocess.run(command, env=given, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert (done.returncode, done.stdout) == expected, done.stderr
    assert "the scheduler requires a certificate; set the environment variables" in done.stderr
