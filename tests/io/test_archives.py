"""Scenes in archives and behind URLs: the same as in folders, and nothing worse than a message where they are bad."""

from __future__ import annotations

import contextlib
import errno
import gzip
import io
import os
import re
import shutil
import tarfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.errors import InputError
from depthcli.core.text import without_secrets
from depthcli.io import storage
from depthcli.io.formats.files import open_regular, read_bytes
from depthcli.io.formats.images import write_png
from depthcli.io.formats.library_files import library_path
from depthcli.io.storage import remote
from depthcli.io.storage.sized import size_of
from depthcli.io.storage.unpacking import UnpackedGzip
from depthcli.io.storage.zips import Zip
from depthcli.io.walk import discover_scenes


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    storage.close_all()


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of two scenes with truth."""
    folder = tmp_path_factory.mktemp("archives") / "scenes"
    for k in range(2):
        image = np.random.default_rng(k).integers(0, 255, (20, 36), np.uint8)
        write_png(folder / f"s{k}" / "left.png", image)
        write_png(folder / f"s{k}" / "right.png", np.roll(image, -3, 1))
        write_png(folder / f"s{k}" / "disp_left.png", np.full((20, 36), 3, np.uint8))
        (folder / f"s{k}" / "meta.json").write_text('{"max_disparity": 8, "disp_scale": 1}')
    return folder


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _zip(folder: Path, target: Path, start: str = "") -> Path:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in _files(folder):
            archive.write(path, start + path.relative_to(folder).as_posix())
    return target


def _tar(folder: Path, target: Path, start: str = "./", mode: str = "w") -> Path:
    with tarfile.open(target, mode) as archive:  # type: ignore[call-overload]
        archive.add(folder, start or ".")
    return target


def _shards(folder: Path, target: Path) -> Path:
    with tarfile.open(target, "w") as archive:
        for path in _files(folder):
            archive.add(path, f"{path.parent.name}.{'json' if path.name == 'meta.json' else path.name}")
    return target


def _add(archive: tarfile.TarFile, name: str, data: bytes = b"", **values: object) -> None:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    for key, value in values.items():
        setattr(info, key, value)
    archive.addfile(info, io.BytesIO(data))


def _results(folder: Path) -> dict[str, bytes]:
    measured = ("report.json", "report.csv")
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in _files(folder) if p.name not in measured}


MAKERS: dict[str, Callable[[Path, Path], Path]] = {
    "a.zip": _zip,
    "top.zip": partial(_zip, start="scenes/"),
    "a.tar": _tar,
    "a.tar.gz": partial(_tar, start="scenes", mode="w:gz"),
    "a.tgz": partial(_tar, mode="w:gz"),
    "shard.tar": _shards,
}


@pytest.mark.parametrize("name", MAKERS)
def test_archive_lists_scenes_as_folder(scenes: Path, tmp_path: Path, name: str) -> None:
    archive = MAKERS[name](scenes, tmp_path / name)
    found, wanted = discover_scenes(archive), discover_scenes(scenes)
    assert [scene.name for scene in found] == [scene.name for scene in wanted] == ["s0", "s1"]
    for scene, other in zip(found, wanted, strict=True):
        assert {k: read_bytes(f) for k, f in scene.input_files.items()} == {
            k: read_bytes(f) for k, f in other.input_files.items()
        }
        assert scene.has_truth


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.zip", "a.tar.gz", "shard.tar"])
def test_run_on_archive_gives_the_same_bytes(scenes: Path, tmp_path: Path, name: str) -> None:
    archive = MAKERS[name](scenes, tmp_path / name)
    for place, output in ((scenes, "folder"), (archive, "archive")):
        assert main(["stereo", "fast", "-i", str(place), "-o", str(tmp_path / output), "-q"]) == 0
    assert _results(tmp_path / "folder") == _results(tmp_path / "archive")
    with contextlib.redirect_stdout(io.StringIO()) as output:
        assert main(["evaluate", str(tmp_path / "archive"), "--truth", str(archive), "--json"]) == 0
    assert '"s1"' in output.getvalue()
    assert main(["stereo", "fast", "-i", str(scenes), "-o", str(tmp_path / "archive"), "--dry-run", "--json"]) == 0


def test_several_shards(scenes: Path, tmp_path: Path) -> None:
    for k in range(3):
        _shards(scenes, tmp_path / f"shard-{k:03d}.tar")
    wanted = [f"shard-{k:03d}/s{n}" for k in range(3) for n in range(2)]
    for place in (tmp_path, tmp_path / "shard-*.tar", tmp_path / "shard-{000..002}.tar"):
        assert [scene.name for scene in discover_scenes(place)] == wanted
    shutil.copytree(scenes / "s0", tmp_path / "one" / "s0")
    _shards(tmp_path / "one", tmp_path / "one.tar")  # of a single sample
    assert [scene.name for scene in discover_scenes(tmp_path / "on*.tar")] == ["one/s0"]
    missing = discover_scenes(tmp_path / "shard-{002..003}.tar")
    assert [bool(scene.problem) for scene in missing] == [False, False, True]


def test_archives_beside_scenes_are_left_alone(scenes: Path, tmp_path: Path) -> None:
    shutil.copytree(scenes, tmp_path / "data")
    _zip(scenes, tmp_path / "data" / "scenes.zip")
    assert [scene.name for scene in discover_scenes(tmp_path / "data")] == ["s0", "s1"]


def test_unsafe_names_lead_nowhere(scenes: Path, tmp_path: Path) -> None:
    lines: list[str] = []
    with zipfile.ZipFile(_zip(scenes, tmp_path / "a.zip"), "a") as archive:
        for name in ("../out/left.png", "/etc/left.png", "s0/../../left.png", "..\\left.png", "C:/left.png"):
            archive.writestr(name, b"x")
    assert len(discover_scenes(tmp_path / "a.zip", warn=lines.append)) == 2
    assert len(lines) == 1 and "5 members not used" in lines[0]


def test_links_devices_and_duplicates_are_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"secret")
    with tarfile.open(tmp_path / "a.tar", "w") as archive:
        _add(archive, "l.png", type=tarfile.SYMTYPE, linkname=str(secret))
        _add(archive, "h.png", type=tarfile.LNKTYPE, linkname="../secret.png")
        _add(archive, "d.png", type=tarfile.CHRTYPE)
        _add(archive, "t.png", b"1")
        _add(archive, "t.png", b"2")
    for name, words in {"l": "a link", "h": "a link", "d": "special", "t": "more than once", "n": "no such"}.items():
        with pytest.raises(Exception, match=rf"a\.tar/{name}\.png: .*{words}"):
            read_bytes(tmp_path / "a.tar" / f"{name}.png")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as made:
        link = zipfile.ZipInfo("l.png")
        link.create_system, link.external_attr = 3, 0o120777 << 16
        made.writestr(link, str(secret))
    with pytest.raises(Exception, match="never followed"):
        read_bytes(tmp_path / "a.zip" / "l.png")


def test_bombs_are_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthcli.io.storage.archive.LARGE_BYTES", 1 << 16)
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("left.png", bytes(1 << 20))
    with pytest.raises(Exception, match="not read"):
        read_bytes(tmp_path / "a.zip" / "left.png")
    monkeypatch.setattr("depthcli.io.storage.unpacking._BOMB_BYTES", 1 << 16)
    (tmp_path / "a.tar.gz").write_bytes(gzip.compress(bytes(1 << 20)))
    with open(tmp_path / "a.tar.gz", "rb") as packed, pytest.raises(OSError, match="not read further"):
        io.BufferedReader(UnpackedGzip(packed)).read()
    with tarfile.open(tmp_path / "h.tar", "w") as archive:  # a name as long as a memory
        _add(archive, "long", bytes(2 << 20), type=tarfile.GNUTYPE_LONGNAME)
        _add(archive, "left.png", b"x")
    with pytest.raises(Exception, match="unreasonable"):
        storage.names(tmp_path / "h.tar")


def _damaged(scenes: Path, place: Path) -> dict[str, bytes]:
    """Archives that cannot be used at all."""
    whole = _zip(scenes, place / "whole.zip").read_bytes()
    return {
        "empty.zip": b"",
        "cut.zip": whole[: len(whole) // 2],
        "text.zip": b"no archive" * 100,
        "empty.tar.gz": b"",
        "text.tar": b"no archive" * 200,
        "text.tgz": b"no archive" * 200,
        "a.tar.xz": b"x",
    }


def test_unusable_archives_are_one_line(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, data in _damaged(scenes, tmp_path).items():
        (tmp_path / name).write_bytes(data)
        assert main(["stereo", "fast", "-i", str(tmp_path / name), "-o", str(tmp_path / "out")]) == 2, name
        (line,) = capsys.readouterr().err.splitlines()
        assert name in line


def _crc(scenes: Path, path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for file in _files(scenes):
            archive.write(file, file.relative_to(scenes).as_posix())
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("s0/right.png").header_offset
    data = bytearray(path.read_bytes())
    data[start + 80] ^= 1
    path.write_bytes(data)


def _encrypted(scenes: Path, path: Path) -> None:
    _zip(scenes, path)
    data = bytearray(path.read_bytes())
    place = data.rindex(b"s0/right.png") - 46
    data[place + 8] |= 1
    path.write_bytes(data)


def _cut_tar(scenes: Path, path: Path) -> None:
    _tar(scenes, path)
    with tarfile.open(path) as archive:
        last = max(archive.getmembers(), key=lambda member: member.offset_data)
    path.write_bytes(path.read_bytes()[: last.offset_data + 5])


def _cut_gzip(scenes: Path, path: Path) -> None:
    _tar(scenes, path, mode="w:gz")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spoil", "words"),
    [
        ("a.zip", _crc, r"a\.zip/s0/right\.png: .*damaged"),
        ("a.zip", _encrypted, r"a\.zip/s0/right\.png: encrypted"),
        ("a.tar", _cut_tar, "cut"),
        ("a.tar.gz", _cut_gzip, "cut"),
    ],
)
def test_other_scenes_of_a_damaged_archive_are_done(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    name: str, spoil: Callable[[Path, Path], None], words: str,
) -> None:  # fmt: skip
    spoil(scenes, tmp_path / name)
    assert main(["stereo", "fast", "-i", str(tmp_path / name), "-o", str(tmp_path / "out"), "-q"]) == 3
    assert re.search(words, capsys.readouterr().err)
    assert len(list((tmp_path / "out").glob("s*/disp_left.pfm"))) == 1


def test_gzip_is_read_from_any_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthcli.io.storage.unpacking._FIRST_SPACING", 1 << 12)
    monkeypatch.setattr("depthcli.io.storage.unpacking._PIECE", 1 << 10)
    monkeypatch.setattr("depthcli.io.storage.unpacking._MAX_POINTS", 8)
    rng = np.random.default_rng(1)
    data = rng.integers(0, 9, 300_000, np.uint8).tobytes()
    packed = gzip.compress(data[:100_000]) + gzip.compress(data[100_000:])
    file = io.BufferedReader(UnpackedGzip(io.BytesIO(packed)))
    assert file.read() == data
    for place in rng.integers(0, len(data), 200):
        file.seek(place)
        assert file.read(500) == data[place : place + 500]


def test_large_members_are_read_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthcli.io.storage.LARGE_BYTES", 1 << 10)
    data = np.random.default_rng(0).bytes(1 << 14)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "v.bin").write_bytes(data)
    for path in (_zip(tmp_path / "in", tmp_path / "a.zip"), _tar(tmp_path / "in", tmp_path / "a.tgz", mode="w:gz")):
        with open_regular(path / "v.bin") as file:
            assert size_of(file) == len(data) and not isinstance(file, io.BytesIO)
            assert file.read() == data
            file.seek(100)
            assert file.read(10) == data[100:110]


def test_changed_archive_is_read_again(scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "_SECONDS_SAME", -1)
    for text in (b"one", b"other"):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr("x", text)
        assert read_bytes(tmp_path / "a.zip" / "x") == text


class _Server(SimpleHTTPRequestHandler):
    """Files with or without parts of them."""

    ranges = True

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self.path = re.sub(r"/get\?.*", "/a.zip", self.path)
        path, wanted = Path(self.translate_path(self.path)), self.headers.get("Range", "")
        found = re.match(r"bytes=(\d+)-(\d*)", wanted) if self.ranges and path.is_file() else None
        if self.path.startswith("/broken"):
            self.send_error(500)
        elif self.path.startswith("/silent"):
            time.sleep(3)
        elif found is None:
            with contextlib.suppress(OSError):
                super().do_GET()
        else:
            size = path.stat().st_size
            start, end = int(found[1]), min(int(found[2] or size - 1), size - 1)
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{end}/{size}")
            self.send_header("Content-Length", str(end - start + 1))
            self.end_headers()
            self.wfile.write(path.read_bytes()[start : end + 1])


@pytest.fixture
def server(scenes: Path) -> Iterator[str]:
    _zip(scenes, scenes.parent / "a.zip")
    _tar(scenes, scenes.parent / "a.tar.gz", mode="w:gz")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Server, directory=str(scenes.parent))) as served:
        thread = threading.Thread(target=served.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{served.server_address[1]}"
        served.shutdown()
        thread.join()


@pytest.mark.slow
def test_urls(scenes: Path, server: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    memory.pipe("/store/a.zip", (scenes.parent / "a.zip").read_bytes())
    for file in _files(scenes):
        memory.pipe(f"/store/scenes/{file.relative_to(scenes).as_posix()}", file.read_bytes())
    wanted = {k: read_bytes(f) for k, f in discover_scenes(scenes)[1].input_files.items()}
    for url in (f"{server}/a.zip", f"{server}/a.tar.gz", f"{server}/scenes", f"file://{scenes}",
                f"{server}/a.zip?X-Signature=a%2Fb&X-Date=1", f"{server}/a.tar.gz?token=b.zip",
                f"file://{scenes.parent}/a.tar.gz", "memory://store/a.zip", "memory://store/scenes"):  # fmt: skip
        found = discover_scenes(url)
        assert [scene.name for scene in found] == ["s0", "s1"], url
        assert {k: read_bytes(f) for k, f in found[1].input_files.items()} == wanted
    for query in ("name=a.zip", "token=x&file=a.zip"):  # a store that names the file behind its address
        assert len(discover_scenes(f"{server}/get?{query}")) == 2
    signed = discover_scenes(f"{server}/a.zip?token=secret")[1].input_files["left"]
    assert storage.location(signed) == f"{server}/a.zip/s1/left.png"
    own = "http://me:secret@127.0.0.1"
    assert storage.location(Path(f"{own}/a.zip/s1/left.png")) == "http://127.0.0.1/a.zip/s1/left.png"
    for url, words in {
        f"{server}/none.zip": "no such file",
        f"{server}/broken.zip": "the server failed",
        "http://127.0.0.1:1/a.zip": "the server failed",
        "nosuch://x/a.zip": "no URL that can be read",
    }.items():
        assert main(["stereo", "fast", "-i", url, "-o", str(tmp_path / "out")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert url.partition("?")[0][-8:] in line and words in line


def test_archives_that_are_not_read_are_said(scenes: Path, tmp_path: Path) -> None:
    shutil.copytree(scenes, tmp_path / "in")
    _zip(scenes, tmp_path / "in" / "more.zip")
    _zip(scenes, tmp_path / "in" / "others.zip")
    lines: list[str] = []
    assert len(discover_scenes(tmp_path / "in", warn=lines.append)) == 2
    assert len(lines) == 1 and "more.zip and 1 more beside the scenes not read" in lines[0]
    (tmp_path / "nest").mkdir()
    _zip(scenes, tmp_path / "nest" / "inner.zip")
    for start in ("", "top/"):
        with pytest.raises(InputError, match=r"it holds archives, such as inner\.zip: unpack it"):
            discover_scenes(_zip(tmp_path / "nest", tmp_path / "outer.zip", start))
    for name, words in (
        ("file.txt", "a file, want a folder, or a .zip"), ("*.zip", "no archive has such a name"),
        ("none", "no such folder"), ("a.rar", "want a .zip"),
    ):  # fmt: skip
        (tmp_path / "words").mkdir(exist_ok=True)
        if "." in name and "*" not in name:
            (tmp_path / "words" / name).write_bytes(b"x")
        with pytest.raises(InputError, match=words):
            discover_scenes(tmp_path / "words" / name)


@pytest.mark.slow
def test_depth_of_a_run_in_an_archive(scenes: Path, tmp_path: Path) -> None:
    assert main(["stereo", "fast", "-i", str(scenes), "-o", str(tmp_path / "run"), "-q"]) == 0
    words = ["--focal", "30", "--baseline", "0.1", "-q", "-o"]
    assert main(["depth", str(tmp_path / "run"), *words, str(tmp_path / "one")]) == 0
    for name, start in (("two", ""), ("three", "runs/")):
        archive = _zip(tmp_path / "run", tmp_path / f"{name}.zip", start)
        assert main(["depth", str(archive), *words, str(tmp_path / name)]) == 0
        for scene in ("s0", "s1"):
            first, second = ((tmp_path / run / scene / "depth.pfm").read_bytes() for run in ("one", name))
            assert first == second


@pytest.mark.slow
def test_a_server_that_does_not_answer_is_waited_for_once(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fsspec")
    monkeypatch.setattr(remote, "_READ_SECONDS", 0.5)
    monkeypatch.setattr(remote, "_NEXT_SECONDS", 0.2)
    monkeypatch.setattr(remote, "_silent", set())
    for longest in (5, 1.5):
        start = time.monotonic()
        with pytest.raises(InputError, match="did not answer in time"):
            remote.open_file(f"{server}/silent/a.zip", False)
        assert time.monotonic() - start < longest


def test_a_directory_that_cannot_be_read_is_not_called_another_kind_of_file(scenes: Path, tmp_path: Path) -> None:
    class Lost(io.BytesIO):
        """A file whose server fails after a while."""

        def read(self, size: int | None = -1) -> bytes:
            raise OSError(errno.EIO, "the server failed")

    data = _zip(scenes, tmp_path / "a.zip").read_bytes()
    assert len(Zip(io.BytesIO(data)).listing.files) == 8
    with pytest.raises(OSError, match="the server failed"):
        Zip(Lost(data))


@pytest.mark.slow
def test_signatures_of_urls_stay_out_of_all_that_is_written(scenes: Path, server: str, tmp_path: Path, capsys) -> None:
    pytest.importorskip("fsspec")
    broken = tmp_path / "in"
    shutil.copytree(scenes, broken)
    (broken / "s0" / "left.png").write_bytes((scenes / "s0" / "left.png").read_bytes()[:300])
    _zip(broken, scenes.parent / "signed.zip")
    url, run = f"{server}/signed.zip?X-Token=SECRET&b=1", tmp_path / "run"
    assert main(["stereo", "fast", "-i", url, "-o", str(run), "--html", "--evaluate"]) == 3
    _zip(run, scenes.parent / "run.zip")
    words = ["--truth", url, "-o", str(tmp_path / "scores"), "--html", "--log", str(tmp_path / "log.jsonl")]
    assert main(["evaluate", str(run), f"{server}/run.zip?X-Token=SECRET", "--maps", "zip={scene}.pfm", *words]) == 2
    assert main(["evaluate", f"own={run}", f"{server}/run.zip?X-Token=SECRET", *words]) == 3
    assert "signed.zip/s0/left.png: truncated PNG" in (run / "report.csv").read_text()
    assert f"{server}/signed.zip" in (tmp_path / "scores" / "scores.json").read_text()
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert len(files) > 10
    assert [file for file in files if b"SECRET" in file.read_bytes()] == []
    assert "SECRET" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https:/host/a.zip?sig=x%2Fy: no such file", "https://host/a.zip: no such file"),
        ("https://host/a.zip?sig=x&t=1:2/s0/left.png: cut off", "https://host/a.zip/s0/left.png: cut off"),
        ("--input 'https://h/get?name=a.zip' -o b", "--input 'https://h/get' -o b"),
        ("s3:/bucket/a.tar?v=1, s3:/b/c?d", "s3://bucket/a.tar, s3://b/c"),
        ("ftp://me:word@host/a.zip", "ftp://host/a.zip"),
        ("/data/what?x=1/left.png: not a PNG, was it: so?", "/data/what?x=1/left.png: not a PNG, was it: so?"),
        ("a@b and C:/x?y", "a@b and C:/x?y"),
    ],
)
def test_urls_are_shown_without_secrets(text: str, shown: str) -> None:
    assert without_secrets(text) == shown


@pytest.mark.slow
def test_server_without_parts_of_files(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fsspec")
    monkeypatch.setattr(_Server, "ranges", False)
    with pytest.raises(Exception, match="gives no parts of files"):
        discover_scenes(f"{server}/a.zip")


def test_urls_without_the_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    assert main(["stereo", "fast", "-i", "https://127.0.0.1/x.zip", "-o", os.devnull]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "https://127.0.0.1/x.zip: " in line and "pip install 'depthcli[remote]'" in line


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["zip", "tar.gz"])
def test_volumes_and_transforms_in_an_archive_are_those_of_the_folder(tmp_path: Path, kind: str, capsys) -> None:
    sitk = pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
    assert main(["sample", "--registration", "-o", str(tmp_path / "in"), "-n", "2", "-q"]) == 0
    pair = tmp_path / "in" / "pair_1"  # of files with values beside the header, and of a transform
    sitk.WriteImage(sitk.ReadImage(str(pair / "moving_warped.nii.gz")), str(pair / "moving.mhd"))
    sitk.WriteTransform(sitk.TranslationTransform(3, (1.5, 0, -0.5)), str(pair / "transform.h5"))
    (pair / "moving_warped.nii.gz").unlink()
    archive = Path(shutil.make_archive(str(tmp_path / "in"), "zip" if kind == "zip" else "gztar", tmp_path / "in"))
    assert archive.name == f"in.{kind}"
    words = ["register-confidence", "mind", "--set", "radius=2", "--set", "half_window=1", "-q"]
    for place, run in ((tmp_path / "in", "folder"), (archive, "archive")):
        assert main([*words, "-i", str(place), "-o", str(tmp_path / run)]) == 0
    own = [path for path in _files(tmp_path / "folder") if path.parent.name.startswith("pair_")]
    assert len(own) > 6
    for path in own:
        assert path.read_bytes() == (tmp_path / "archive" / path.relative_to(tmp_path / "folder")).read_bytes(), path


def test_volumes_in_an_archive_may_have_the_longest_names(tmp_path: Path) -> None:
    name = "v" * 247 + ".nii.gz"  # 254 bytes
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(b"values")
    archive = _zip(tmp_path / "in", tmp_path / "in.zip")
    with library_path(archive / name) as path:
        assert path.read_bytes() == b"values"


def test_a_volume_that_is_cut_off_in_an_archive_is_one_line(tmp_path: Path, capsys) -> None:
    pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
    for name in ("fixed", "moving_warped"):
        (tmp_path / "in" / "pair").mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / "pair" / f"{name}.nii.gz").write_bytes(gzip.compress(b"\0" * 500)[:-9])
    archive = _zip(tmp_path / "in", tmp_path / "in.zip")
    assert main(["register-confidence", "mind", "-i", str(archive), "-o", str(tmp_path / "run"), "-q"]) == 3
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "fixed.nii.gz" in err
