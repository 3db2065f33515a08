"""A Ray cluster of several nodes, all on this machine."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from vidphys.runs.cluster import set_up_own

STORE = 10**8  # bytes of objects a node, near the least that Ray takes
PORTS = "metrics_agent", "runtime_env_agent", "dashboard_agent_listen", "metrics_export"


def node(cores: int) -> dict[str, int]:
    """What a node is started with: ports of ours, for which Ray need not wait."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in PORTS]
    found = {f"{n}_port": s.getsockname()[1] for n, s in zip(PORTS, sockets, strict=True)}
    for each in sockets:
        each.close()
    return {"num_cpus": cores, "object_store_memory": STORE, **found}


@contextmanager
def cluster(cores: int = 1) -> Iterator:
    """A head of so many cores, to which nodes can be added and lost again."""
    set_up_own()
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args=node(cores))
    try:
        yield made
    finally:
        made.shutdown()
