"""Scenes in archives and behind URLs: the same as in folders, and one line where they are bad."""

import contextlib
import os
import shutil
import sys
import tarfile
import threading
import time
import zipfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.text import without_secrets
from depthcli.io.scenes import places
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.io.scenes.places import local, origin
from tests.command_line import contents, run, start
from tests.files import laid
from tests.golden import refused


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "depthcli" / "inputs"


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of two scenes with truth."""
    folder = tmp_path_factory.mktemp("archives") / "scenes"
    for k in range(2):
        image = np.random.default_rng(k).integers(0, 255, (20, 36), np.uint8)
        images = {"left.png": image, "right.png": np.roll(image, -3, 1), "disp_left.png": np.full_like(image, 3)}
        laid(folder / f"s{k}", images | {"meta.json": {"max_disparity": 8, "disp_scale": 1}})
    return folder


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _packed(folder: Path, target: Path, top: bool = False) -> Path:
    """Pack a folder, below its own name if ``top``, into an archive of the kind that the target's name says."""
    kind = {".zip": "zip", ".tar": "tar", ".gz": "gztar", ".tgz": "gztar", ".xz": "xztar"}[target.suffix]
    place = (folder.parent, folder.name) if top else (folder,)
    return Path(shutil.make_archive(str(target.with_name("made")), kind, *place)).rename(target)


@pytest.mark.parametrize("top", [False, True])
@pytest.mark.parametrize("name", ["a.zip", "a.tar", "a.tar.gz", "a.tar.xz"])
def test_archive_is_its_folder(scenes: Path, tmp_path: Path, name: str, top: bool) -> None:
    archive = _packed(scenes, tmp_path / name, top)
    assert contents(local(archive)) == contents(scenes)
    found = discover_scenes(archive, ALL_KINDS)
    assert [scene.name for scene in found] == ["s0", "s1"] and all(scene.has_truth for scene in found)
    left = archive / ("scenes/s1/left.png" if top else "s1/left.png")
    assert origin(found[1].input_files["left"]) == str(left)
    assert local(left).read_bytes() == (scenes / "s1/left.png").read_bytes()


@pytest.mark.slow
def test_commands_on_archives_give_the_bytes_of_the_folder(scenes: Path, tmp_path: Path, tool) -> None:
    archive = _packed(scenes, tmp_path / "scenes.zip")
    for place, output in ((scenes, "folder"), (archive, "archive")):
        assert run("stereo", "fast", "-i", place, "-o", tmp_path / output, "-q") == 0
    assert contents(tmp_path / "folder") == contents(tmp_path / "archive")
    made = _packed(tmp_path / "folder", tmp_path / "run.zip")
    assert '"s1"' in tool.out(0, "evaluate", made, "--truth", archive, "--json")
    for place, output in ((tmp_path / "folder", "one"), (made, "two")):
        assert run("depth", place, "--focal", "30", "--baseline", "0.1", "-q", "-o", tmp_path / output) == 0
    assert (tmp_path / "one/s1/depth.pfm").read_bytes() == (tmp_path / "two/s1/depth.pfm").read_bytes()


def test_changed_archive_is_unpacked_again(tmp_path: Path, cache: Path) -> None:
    for text in ("one", "other"):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr("x", text)
        assert [(local(tmp_path / "a.zip") / "x").read_text() for _ in range(2)] == [text] * 2
    assert len(list(cache.iterdir())) == 2
    refused(InputError, discover_scenes, tmp_path, ALL_KINDS)  # a folder of archives names one


def test_an_archive_of_too_many_members_and_a_cache_that_another_process_fills(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slower(made: str, folder: Path) -> None:
        shutil.copytree(made, folder)
        raise OSError(39, "Directory not empty")

    def full(made: str, folder: Path) -> None:
        raise OSError(28, "No space left on device")

    one, other = (_packed(scenes, tmp_path / name) for name in ("a.zip", "b.zip"))
    monkeypatch.setattr(os, "rename", slower)
    assert contents(local(one)) == contents(scenes)
    monkeypatch.setattr(os, "rename", full)
    refused(InputError, local, other)
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    left = local(other) / "s0/left.png"
    assert origin(left) == str(other / "s0/left.png")
    next(left.parents[2].glob("*.origin")).unlink()
    assert origin(left) == str(left)
    monkeypatch.setattr(places, "_MAX_MEMBERS", 7)
    for archive in (_packed(scenes, tmp_path / "c.zip"), _packed(scenes, tmp_path / "c.tar")):
        refused(InputError, local, archive)


def test_urls_of_what_is_too_large_or_needs_another_package(scenes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = pytest.importorskip("fsspec").filesystem("memory")
    for file in _files(scenes):
        memory.pipe(f"/large/{file.relative_to(scenes).as_posix()}", file.read_bytes())
    memory.pipe("/large.zip", bytes(20))
    monkeypatch.setattr(places, "_MAX_MEMBERS", 7)
    monkeypatch.setattr(places, "_MAX_CACHE_BYTES", 19)
    monkeypatch.setitem(sys.modules, "s3fs", None)
    for url in ("memory://large", "memory://large.zip", "s3://large.zip"):
        refused(InputError, local, url)
    monkeypatch.setitem(sys.modules, "fsspec", None)  # without the library the extra is named
    refused(InputError, local, "https://127.0.0.1/x.zip")


def test_nothing_is_written_outside_and_links_are_not_made(scenes: Path, tmp_path: Path, cache: Path, caplog) -> None:
    with zipfile.ZipFile(_packed(scenes, tmp_path / "a.zip"), "a") as archive:
        for name in ("../out/left.png", "/etc/left.png", "s0/../../left.png", "..\\left.png", "C:/left.png"):
            archive.writestr(name, b"x")
        link = zipfile.ZipInfo("link.png")
        link.create_system, link.external_attr = 3, 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
    with tarfile.open(tmp_path / "b.tar", "w") as tar:
        tar.add(scenes / "s0", "s0")
        for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE):
            member = tarfile.TarInfo(f"s0/{kind.decode()}.png")
            member.type, member.linkname = kind, "/etc/passwd"
            tar.addfile(member)
    for name, files, left_out in (("a.zip", 8, 6), ("b.tar", 4, 3)):
        caplog.clear()
        assert len(_files(local(tmp_path / name))) == files
        assert f"{left_out} members not used" in caplog.text
    assert not [path for path in _files(tmp_path) if not path.is_relative_to(cache) and path.parent != tmp_path]
    for _ in range(2):  # every run says it once
        caplog.clear()
        assert run("stereo", "opencv-bm", "-i", tmp_path / "a.zip", "-o", tmp_path / "o") == 0
        assert caplog.text.count("6 members not used, links or names that lead out") == 1


def _spoiled(scenes: Path, place: Path) -> dict[str, bytes]:
    whole, tar = _packed(scenes, place / "whole.zip").read_bytes(), _packed(scenes, place / "w.tar").read_bytes()
    packed, bit = _packed(scenes, place / "w.tgz").read_bytes(), bytearray(whole)
    bit[len(bit) // 3] ^= 1  # of an image
    header = tarfile.TarInfo("long")
    header.type, header.size = tarfile.GNUTYPE_LONGNAME, 2 << 20
    laid(place, {"zeros/zeros": bytes(1 << 21)})
    return {
        "empty.zip": b"", "cut.zip": whole[: len(whole) // 2], "text.tgz": b"no archive" * 200, "bit.zip": bytes(bit),
        "cut.tar": tar[: 3 * len(tar) // 4], "end.tar": tar.rstrip(b"\0"), "cut.tgz": packed[: 3 * len(packed) // 4],
        "name.tar": header.tobuf() + bytes(2 << 20) + tar,
        "bomb.tgz": _packed(place / "zeros", place / "z.tgz").read_bytes(),
    }  # fmt: skip


def test_the_cache_has_a_limit_and_no_leftovers(scenes: Path, tmp_path: Path, cache: Path, monkeypatch) -> None:
    first = local(_packed(scenes, tmp_path / "a.zip"))
    dead, living = cache / ".dead", cache / ".living"
    for folder in (dead, living):
        folder.mkdir()
    os.utime(dead, (0, 0))
    second = local(_packed(scenes, tmp_path / "b.zip"))
    assert first.is_dir() and second.is_dir() and not dead.exists() and living.exists()
    monkeypatch.setattr(places, "_MAX_CACHE_BYTES", 1)
    os.utime(first.parent if first.parent.parent == cache else first, (0, 0))
    local(_packed(scenes, tmp_path / "c.zip"))
    assert not first.exists() and second.exists()  # which was used today


def test_unusable_archives_are_one_line(scenes: Path, tmp_path: Path, cache: Path, monkeypatch, tool) -> None:
    monkeypatch.setattr(places, "_ALWAYS_BYTES", 1 << 20)
    for name, data in _spoiled(scenes, tmp_path).items():
        (tmp_path / name).write_bytes(data)
        (line,) = tool.err(2, "stereo", "fast", "-i", tmp_path / name, "-o", tmp_path / "out").splitlines()
        assert name in line and len(line) < 300
    assert not list(cache.iterdir())


class _Server(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def do_HEAD(self) -> None:
        if not self.path.startswith("/stalled"):
            return super().do_HEAD()
        self.send_response(200)
        self.send_header("Content-Length", "5000000")
        self.end_headers()

    def do_GET(self) -> None:
        if self.path.startswith("/broken"):
            return self.send_error(500)
        if self.path.startswith("/stalled"):  # the first bytes of a file, then nothing
            self.do_HEAD()
            self.wfile.write(b"x" * 1000)
            self.wfile.flush()
            return time.sleep(20)
        if self.path.startswith("/get?"):  # a store that names the file behind its address
            self.path = "/a.zip"
        with contextlib.suppress(OSError):
            super().do_GET()


@pytest.fixture
def server(scenes: Path) -> Iterator[str]:
    _packed(scenes, scenes.parent / "a.zip")
    _packed(scenes, scenes.parent / "a.tar.gz")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Server, directory=str(scenes.parent))) as served:
        thread = threading.Thread(target=served.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{served.server_address[1]}"
        served.shutdown()
        thread.join()


@pytest.mark.slow
def test_urls(scenes: Path, server: str, tmp_path: Path, tool) -> None:
    memory = pytest.importorskip("fsspec").filesystem("memory")
    memory.pipe("/store/a.zip", (scenes.parent / "a.zip").read_bytes())
    for file in _files(scenes):
        memory.pipe(f"/store/scenes/{file.relative_to(scenes).as_posix()}", file.read_bytes())
    for url in (
        *(f"{server}/{end}" for end in ("a.zip", "scenes", "a.zip?X-Signature=a%2Fb&c=1", "get?token=x&file=a.zip")),
        f"file://{scenes}", f"file://{scenes.parent}/a.tar.gz", "memory://store/a.zip", "memory://store/scenes",
    ):  # fmt: skip
        assert [scene.name for scene in discover_scenes(url, ALL_KINDS)] == ["s0", "s1"], url
        assert contents(local(url)) == contents(scenes), url
    signed = discover_scenes(f"{server}/a.zip?token=secret", ALL_KINDS)[1].input_files["left"]
    assert origin(signed) == f"{server}/a.zip/s1/left.png"
    pair = [f"{server}/a.zip/s1/left.png", "--right", f"{server}/scenes/s1/right.png", "--max-disparity", "8"]
    tool.both(0, "stereo", "fast", "--left", *pair, "-o", tmp_path / "pair", "-q")
    for url, words in {
        f"{server}/none.zip": "no such file", f"{server}/broken.zip": "the server failed",
        "http://127.0.0.1:1/a.zip": "the server failed", "nosuch://x/a.zip": "no URL that can be read",
    }.items():  # fmt: skip
        (line,) = tool.err(2, "stereo", "fast", "-i", url, "-o", tmp_path / "out").splitlines()
        assert url in line and words in line


@pytest.mark.slow
def test_signatures_of_urls_stay_out_of_all_that_is_written(scenes: Path, server: str, tmp_path: Path, capsys) -> None:
    pytest.importorskip("fsspec")
    shutil.copytree(scenes, tmp_path / "in")
    (tmp_path / "in/s0/left.png").write_bytes((scenes / "s0/left.png").read_bytes()[:300])
    _packed(tmp_path / "in", scenes.parent / "signed.zip")
    url = f"{server}/signed.zip?X-Credential=A/b/c&X-Token=SECRET"
    made, table = tmp_path / "run", tmp_path / "pairs.csv"
    assert run("stereo", "fast", "-i", url, "-o", made, "--html", "--evaluate") == 3
    _packed(made, scenes.parent / "run.zip")
    table.write_text(f"left,right\n{url},{url}\n{url}/s0/left.png,{url}/s0/right.png\n")
    assert run("stereo", "fast", "-i", table, "-o", tmp_path / "listed", "--html") == 3
    table.unlink()
    runs = f"own={made}", f"{server}/run.zip?X-Token=SECRET"
    assert run("evaluate", *runs, "--truth", url, "-o", tmp_path / "scores", "--html") == 3
    assert f"{server}/signed.zip" in (tmp_path / "scores" / "scores.json").read_text()
    assert [file for file in _files(tmp_path) if b"SECRET" in file.read_bytes()] == []
    assert "SECRET" not in "".join(capsys.readouterr())


def test_urls_are_shown_without_secrets() -> None:
    for text, shown in (
        ("https:/host/a.zip?sig=x%2Fy: no such file", "https://host/a.zip: no such file"),
        ("https://host/a.zip?sig=x&t=1:2/s0/left.png: cut off", "https://host/a.zip: cut off"),
        ("https://host/l.png?Credential=A/2024/s3&Signature=b/c: cut off", "https://host/l.png: cut off"),
        ("(got 'https://h/l?sig=a/b,https://h/r?sig=c/d'", "(got 'https://h/l'"),
        ("--input 'https://h/get?name=a.zip' -o b", "--input 'https://h/get' -o b"),
        ("ftp://me:word@host/a.zip", "ftp://host/a.zip"),
        ("/data/what?x=1/left.png: not a PNG, was it: so?", "/data/what?x=1/left.png: not a PNG, was it: so?"),
    ):
        assert without_secrets(text) == shown


@pytest.mark.system
def test_a_download_that_is_ended_says_so_and_leaves_nothing(server: str, tmp_path: Path, cache: Path) -> None:
    pytest.importorskip("aiohttp")
    process = start("stereo", "opencv-bm", "-i", f"{server}/stalled.zip", "-o", tmp_path / "o")
    try:
        end = time.monotonic() + 120
        while not list(cache.glob(".*")):
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.1)
        time.sleep(1)
        process.terminate()
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out) == (143, "")
    assert err.splitlines() == ["depthcli: terminated; run the same command again to resume"]
    assert not list(cache.glob("*")) and not list(cache.glob(".*"))
