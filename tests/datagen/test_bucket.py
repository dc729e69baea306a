"""Datasets made in a bucket: a real S3 server, behind a proxy by which requests fail; the bytes are as in a folder."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from urllib.parse import unquote

import fsspec
import pytest

import multilight
from multilight.datagen.cli import main
from multilight.datagen.errors import RunStoppedError
from multilight.datagen.production import drivers, remote, running, worker
from multilight.datagen.production.bucket import Bucket
from multilight.datagen.storage.address import find_place
from tests.datagen.driver_faults import Here
from tests.datagen.servers import Fault, FaultyBucket

SCENES = 6
SETTINGS = ["--renderer", "analytic", "--kind", "spheres", "--width", "32", "--height", "32"]
SETTINGS += ["--views", "2", "--spp", "1", "--workers", "1", "--scenes", str(SCENES)]
ADDRESS = "s3://bucket/set"


LEASE = 1.5
"""Seconds, instead of a minute."""


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have dead runs count as such soon, and be asked about often."""
    monkeypatch.setattr(drivers, "LEASE", LEASE)
    monkeypatch.setattr(Bucket, "pause", 0.1)
    worker._remote.cache_clear()


@pytest.fixture(autouse=True)
def stage_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what other tests make at the same time out of `stages`."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make scenes in the driver's own process, since workers take seconds to start."""
    monkeypatch.setattr(running, "Crew", Here)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a run in a folder makes."""
    root = tmp_path_factory.mktemp("alone") / "set"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "Crew", Here)
        assert main(["dataset", "--out", f"file://{root}", *SETTINGS]) == 0
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def put(bucket: FaultyBucket, contents: dict[str, bytes]) -> None:
    for name, content in contents.items():
        bucket.write(f"set/{name}", content)


def make(*words: str) -> int:
    return main(["dataset", "--out", ADDRESS, *SETTINGS, *words])


def stages() -> list[str]:
    base = Path(tempfile.gettempdir(), f"multilight-{os.getuid()}")
    return [path.name for path in base.iterdir()] if base.exists() else []


def test_a_bucket_gets_the_bytes_of_a_folder_and_is_read(
    bucket: FaultyBucket, alone: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    assert make("--workers", "2") == 0
    assert bucket.contents("set") == alone
    assert stages() == []
    order = [path for method, path in bucket.asked if method == "PUT" and "/scenes/000003/" in path]
    assert order[-1].endswith("scene.json"), "a scene is there when its record is"
    for words in (["verify"], ["stats"], ["status"], ["query"]):
        assert main([*words, ADDRESS]) == 0
    assert f"{SCENES} of {SCENES} scenes done" in capsys.readouterr().out
    settings = multilight.SampleSettings(size=32, length=2, split=None, visible=1)
    assert multilight.MultiLightDataset(ADDRESS, settings)[1]["target"].shape == (3, 32, 32)
    bucket.asked.clear()
    assert make() == 0
    assert "nothing to do" in capsys.readouterr().out
    listings = [path for _, path in bucket.asked if "prefix=set/scenes/&" in unquote(path)]
    assert len(listings) == 1
    assert not [asked for asked in bucket.asked if "/scenes/0" in asked[1]], "finished scenes are not asked for"
    assert len(multilight.make(ADDRESS, progress=False)) == SCENES


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0])
def test_one_request_in_ten_fails(
    bucket: FaultyBucket, alone: dict[str, bytes], tmp_path: Path, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, happened = random.Random(seed), Counter[str]()
    faults: list[Fault] = ["500", "503", "no answer", "lost answer", "late", "cut"]

    def fault(method: str, path: str) -> Fault | None:
        found = rng.choice(faults) if rng.random() < 0.1 else None
        if found == "cut" and method != "PUT":
            return None
        happened.update([found] if found else [])
        return found

    bucket.fault = fault
    assert make("--log-json", str(tmp_path / "log"), "--workers", "2") == 0
    assert bucket.contents("set") == alone
    said = capsys.readouterr().out
    assert sum(happened.values()) > 10
    count = re.search("([0-9]+) requests tried again", said)
    assert count is not None, (said, happened)
    events = [json.loads(line)["event"] for line in (tmp_path / "log").read_text().splitlines()]
    assert 0 < events.count("request tried again") <= int(count[1])


def test_credentials_that_expire(
    bucket: FaultyBucket,
    alone: dict[str, bytes],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    expired = False

    def fault(method: str, path: str) -> Fault | None:
        nonlocal expired
        expired = expired or path.endswith("scenes/000002/scene.json")
        return "expired" if expired else None

    bucket.fault = fault
    assert make("--log-json", str(tmp_path / "log")) == 1
    said = capfd.readouterr()
    assert f"error: {ADDRESS}: access is refused" in said.err
    assert "renew the credentials and run the same command again, finished scenes are kept" in said.err
    secrets = [value for name, value in bucket.environment.items() if name.endswith(("KEY", "TOKEN", "KEY_ID"))]
    logged = (tmp_path / "log").read_text()
    assert "access is refused" in logged
    there = b"".join(bucket.contents("set").values()).decode(errors="replace")
    for secret in secrets:
        assert secret not in said.out + said.err + logged + there
    assert stages() == []
    bucket.fault = lambda method, path: None
    put(bucket, {".drivers/0123456789ab.json": b"{}"})  # of a run that was killed
    monkeypatch.setattr(running, "Crew", Here)
    assert make("--traceback") == 0
    assert {n: c for n, c in bucket.contents("set").items() if not n.startswith(".drivers/")} == alone


@pytest.mark.usefixtures("here")
def test_runs_share_a_bucket_and_take_over_from_a_dead_one(bucket: FaultyBucket, alone: dict[str, bytes]) -> None:
    code = "from multilight.datagen import cli; from multilight.datagen.production import bucket"
    code += f"; bucket.BEAT = {LEASE / 5}; cli.main()"
    command = [sys.executable, "-c", code, "dataset", "--out", ADDRESS, *SETTINGS]
    other = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    killed = False

    def fault(method: str, path: str) -> Fault | None:
        nonlocal killed
        if not killed and path.endswith("/scene.json") and method == "PUT":
            killed = True
            os.killpg(other.pid, signal.SIGKILL)
        return None

    while not [path for method, path in bucket.asked if method == "PUT" and ".drivers/000000" in path]:
        time.sleep(0.05)
    bucket.fault = fault
    assert make() == 0
    assert other.wait(60) == -signal.SIGKILL
    assert bucket.contents("set") == alone
    assert make() == 0
    assert stages() == [], "what a killed run left here goes with the next one"


@pytest.mark.usefixtures("here")
def test_what_is_lost_or_damaged_is_made_anew(bucket: FaultyBucket, alone: dict[str, bytes]) -> None:
    put(bucket, alone)
    bucket.write("set/scenes/000000/views/01.exr", b"cut")
    changed = alone["scenes/000001/views/00.exr"]
    bucket.write("set/scenes/000001/views/00.exr", changed[:-1] + bytes([changed[-1] ^ 1]))
    bucket.remove("set/scenes/000002/scene.json")
    bucket.write("set/index.parquet", b"cut")
    bucket.write("set/scenes/000003/more.txt", b"more")
    assert make("--repair") == 0
    assert bucket.contents("set") == alone


@pytest.mark.usefixtures("here")
def test_a_killed_runs_rows_are_found(
    bucket: FaultyBucket, alone: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its scenes are there, and their rows, but no index: no record is read."""
    monkeypatch.setattr(running, "BETWEEN", 1e9)  # on a slow machine the first index would come before all scenes
    bucket.fault = lambda method, path: "expired" if method == "PUT" and path.endswith("index.parquet") else None
    assert make() == 1
    assert sum(name.startswith(".rows/") for name in bucket.contents("set")) == SCENES
    bucket.fault = lambda method, path: None
    bucket.asked.clear()
    assert make() == 0
    assert not [asked for asked in bucket.asked if "/scenes/0" in asked[1]]
    assert {n: c for n, c in bucket.contents("set").items() if not n.startswith(".drivers/")} == alone


def test_scenes_that_are_set_aside(
    bucket: FaultyBucket, alone: dict[str, bytes], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "TRIES", 1)
    put(bucket, {name: content for name, content in alone.items() if "/000003/" not in name})
    assert make("--limit-minutes", "0.0001") == 1
    assert f"log {ADDRESS}/set_aside/000003.log" in capsys.readouterr().err
    assert b"took longer" in bucket.contents("set")["set_aside/000003.log"]
    assert main(["status", ADDRESS]) == 0
    assert (
        "failed     1: took longer than 0 s; raise --limit-minutes or lower --spp (scenes 3)" in capsys.readouterr().out
    )
    monkeypatch.setattr(running, "Crew", Here)
    assert make("--retry") == 0
    assert bucket.contents("set") == alone


def refused(capsys: pytest.CaptureFixture[str], address: str, *words: str) -> str:
    assert main(["dataset", "--out", address, *SETTINGS, *words]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


def test_addresses_that_do_not_do(
    bucket: FaultyBucket, alone: dict[str, bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    put(bucket, alone)
    bucket.write("other/mine.txt", b"")
    bucket.write("copy/dataset.json", alone["dataset.json"])
    bucket.write("copy/manifest.json", b"{}")
    assert f"{ADDRESS} was made with seed = 0, not 8" in refused(capsys, ADDRESS, "--seed", "8")
    assert "holds other files and no dataset.json" in refused(capsys, "s3://bucket/other")
    assert "s3://bucket/copy is a packed copy or an export" in refused(capsys, "s3://bucket/copy")
    assert "no such bucket; make it first" in refused(capsys, "s3://nothing/set")
    for address in ("memory://set", bucket.environment["AWS_ENDPOINT_URL"]):
        assert "cannot be written to by several processes; name a folder or a bucket" in refused(capsys, address)
    assert bucket.contents("set") == alone
    assert stages() == []


def test_half_of_what_is_written_is_noticed(bucket: FaultyBucket) -> None:
    place, left = remote.Remote(ADDRESS), 2

    def fault(method: str, path: str) -> Fault | None:
        nonlocal left
        left -= method == "PUT"
        return "cut" if method == "PUT" and left >= 0 else None

    bucket.fault = fault
    place.write("written", b"whole")
    left = 1
    assert place.create("created", "whole")
    assert not place.create("created", "other")
    assert bucket.contents("set") == {"written": b"whole", "created": b"whole"}


@pytest.mark.parametrize(
    ("wrong", "where", "parts", "tries"),
    [
        (("500",), "partNumber=2", {1: 1, 2: 2, 3: 1}, 0),
        (("no answer",), "partNumber=3", {1: 1, 2: 1, 3: 2}, 0),
        (("cut",), "partNumber=3", {1: 2, 2: 2, 3: 2}, 1),
        (("lost answer", "gone"), "POST", {1: 1, 2: 1, 3: 1}, 0),  # put together, of which only the second try hears
    ],
)
def test_a_large_file_goes_in_parts(
    bucket: FaultyBucket,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    wrong: tuple[Fault, ...],
    where: str,
    parts: dict[int, int],
    tries: int,
) -> None:
    """What fails of a part is sent again alone; only where the whole came out too short all of it is."""
    monkeypatch.delenv("AWS_MAX_ATTEMPTS")
    fsspec.config.conf.pop("s3")  # with it, on a slow machine, parts would be late
    monkeypatch.setattr("s3fs.core.calculate_chunksize", lambda size, chunksize=None: 5 << 20)  # instead of 50 MiB
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    left = [*wrong]

    def fault(method: str, path: str) -> Fault | None:
        return left.pop(0) if left and where in f"{method} {path}" and "uploadId=" in path else None

    bucket.fault = fault
    content = random.Random(0).randbytes(11 << 20)
    (tmp_path / "large").write_bytes(content)
    place = remote.Remote(ADDRESS)
    place.send(tmp_path / "large", "large")
    assert left == []
    assert bucket.contents("set")["large"] == content
    sent = Counter(int(found[1]) for method, path in bucket.asked if (found := re.search("partNumber=([0-9]+)", path)))
    assert sent == parts
    assert len(place.retried) == tries
    assert place.place.filesystem.list_multipart_uploads("bucket") == []
    fsspec.get_filesystem_class("s3").clear_instance_cache()


def test_patience_ends(bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "FIRST", 0.01)
    monkeypatch.setattr(remote, "TOTAL", 1.0)
    bucket.fault = lambda method, path: "500"
    place = remote.Remote(ADDRESS)
    with pytest.raises(RunStoppedError, match=r"s3://bucket/set: it still fails after [0-9] s .*said the proxy"):
        place.write("x", b"")
    assert place.retried


def test_passwords_are_not_shown() -> None:
    pytest.importorskip("aiohttp")
    place = find_place("http://me:secret@127.0.0.1:1/set")
    assert "secret" not in repr(place)
    assert place.address == "http://127.0.0.1:1/set"
