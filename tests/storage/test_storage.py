"""Files that are whole or not there, and tables that grow row by row."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from clalign.errors import ResultError
from clalign.storage.files import KERNEL_VARIABLE, duration_text, make_folder, replaced_file, size_text, write_text
from clalign.storage.rows import RowFile, append_rows, complete_rows


@dataclass(frozen=True)
class Measured:
    name: str
    length: float | None = None
    count: int | None = None
    sound: bool | None = None
    values: tuple[float, ...] = field(default=(), metadata={"stored": False})


def test_a_file_is_replaced_when_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "document.txt"
    with replaced_file(path) as stream:
        stream.write(b"first")
        assert not path.exists()
    with replaced_file(path, durable=True) as stream:
        stream.write(b"second")
        assert path.read_bytes() == b"first"
    assert path.read_bytes() == b"second"
    with contextlib.suppress(KeyboardInterrupt), replaced_file(path) as stream:
        stream.write(b"half of the thi")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"second"
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    write_text(tmp_path / "a" / "b" / "text.md", "one\r\nξ\n")
    assert (tmp_path / "a" / "b" / "text.md").read_bytes() == "one\r\nξ\n".encode()
    with pytest.raises(ResultError, match=r"gone/text\.md: cannot be written"):
        write_text(tmp_path / "gone" / "text.md", "")
    with pytest.raises(ResultError, match=r"text\.md/c: cannot make this folder"):
        make_folder(tmp_path / "a" / "b" / "text.md" / "c")


def test_rows_of_every_type_survive_the_file(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.csv", Measured, digits=4)
    assert file.read() == []
    rows = [Measured('two\nlines, a comma and a "quote"', 1.5, 3, True, (1.0,)), Measured("b", sound=False)]
    for row in rows:
        file.append(row)
    read = [Measured('two lines, a comma and a "quote"', 1.5, 3, True), *rows[1:]]
    assert file.read() == read
    file.write([Measured("long", 0.123456), Measured("c")])
    assert file.path.read_text() == "name,length,count,sound\nlong,0.1235,,\nc,,,\n"
    assert list(tmp_path.iterdir()) == [file.path]


def test_a_line_that_was_cut_short_costs_only_itself(tmp_path: Path) -> None:
    path, header = tmp_path / "rows.csv", ["name", "text"]
    first, last = ["a", "1"], ["c", "37"]
    for cut in range(1, 21):
        path.unlink(missing_ok=True)
        append_rows(path, header, [first, ["b", "quoted, and cut"]])
        path.write_bytes(path.read_bytes()[:-cut])
        assert complete_rows(path, header) == [first]
        append_rows(path, header, [last])
        assert complete_rows(path, header) == [first, last]
    path.write_bytes(b"name,te")
    assert complete_rows(path, header) == []
    append_rows(path, header, [last])
    assert complete_rows(path, header) == [last]


def test_a_table_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("x,y\n1,2\n")
    with pytest.raises(ResultError, match=r"rows\.csv: was not written by this version"):
        RowFile(tmp_path / "rows.csv", Measured).read()


def test_durations_are_no_finer_than_an_estimate() -> None:
    assert [duration_text(seconds) for seconds in (0.2, 42, 600, 9000)] == ["5 s", "40 s", "10 min", "2.5 h"]


def test_sizes_are_written_as_people_read_them() -> None:
    assert [size_text(size) for size in (999, 3 * 2**10, 18.4 * 2**20, 1.25 * 2**30)] == [
        "999 bytes",
        "3 KiB",
        "18 MiB",
        "1.2 GiB",
    ]


@pytest.mark.skipif(os.name != "posix", reason="folders are locked with flock")
def test_processes_at_once_have_kernel_folders_of_their_own_and_later_ones_use_them_again(tmp_path: Path) -> None:
    program = (
        "import os, sys; from clalign.storage.files import claim_kernel_folder as claim; claim(); claim();"
        f"print(os.environ[{KERNEL_VARIABLE!r}], flush=True); sys.stdin.read()"
    )
    environment = {**os.environ, KERNEL_VARIABLE: str(tmp_path)}

    def folders(count: int) -> list[str]:
        pipe = subprocess.PIPE
        running = [
            subprocess.Popen([sys.executable, "-c", program], stdin=pipe, stdout=pipe, text=True, env=environment)
            for _ in range(count)
        ]
        claimed = [process.stdout.readline().strip() for process in running if process.stdout is not None]
        for process in running:
            process.communicate()
        return sorted(claimed)

    wanted = [str(tmp_path / f"worker-{number}") for number in range(2)]
    assert folders(2) == wanted
    assert folders(1) == wanted[:1]


@pytest.mark.skipif(os.name != "posix", reason="folders are locked with flock")
def test_a_worker_gets_a_temporary_kernel_folder_where_none_can_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    program = (
        "import os; from clalign.storage.files import claim_kernel_folder; claim_kernel_folder();"
        f"print(os.environ[{KERNEL_VARIABLE!r}])"
    )
    environment = {**os.environ, KERNEL_VARIABLE: str(tmp_path / "file" / "kernels")}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    folder = Path(done.stdout.strip())
    assert folder.name == "worker-0"
    assert folder.parent.name.startswith("clalign-kernels-")
    assert not folder.parent.exists()
