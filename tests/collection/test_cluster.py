"""Local workers: what they are given, and what they leave behind."""

from __future__ import annotations

import os
from pathlib import Path

from clalign.collection.cluster import open_client, worker_environment


def test_each_run_shares_the_processors_out_anew(tmp_path: Path) -> None:
    """In one process, the workers of a second run get its shares and not those of the first."""
    before = dict(os.environ)
    for workers in (1, 2):
        shares = worker_environment(workers)
        with open_client(None, workers, tmp_path) as client:
            seen = client.run(lambda: dict(os.environ))
            assert len(seen) == workers
            for environment in seen.values():
                assert {name: environment.get(name) for name in shares} == shares
    after = dict(os.environ)
    assert {name: after.get(name) for name in shares} == {name: before.get(name) for name in shares}
