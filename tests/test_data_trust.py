"""A folder, a record, labels or a lock of a stranger: nothing is written, hangs, takes memory or reads as something else."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import zipfile
from functools import partial

import fsspec
import numpy as np
import pytest
import zarr
from flip_bytes import answer_of, notice
from numcodecs import Blosc
from topokit.data._group import Group, decode
from topokit.data._layout import encode, label_fields, skeleton
from topokit.data._records import index_bytes, parse, record_path

from topokit import _archive
from topokit._archive import FormatError, load_archive, save_archive
from topokit._config import load
from topokit.cli import main
from topokit.data import Dataset, DatasetConfig, WindowDataset, check_dataset, generate_dataset, label_dataset

from conftest import DATA, memory
from small_datasets import OPTIONS, SEED, TINY, command, labelled, wait_until, without_dask

EPISODES = 3
SECRET = "a line of somebody else's\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset with labels; not to be changed."""
    return labelled(tmp_path_factory.mktemp("made") / "data", EPISODES, observed=False)


@pytest.fixture
def copy(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


@pytest.fixture
def secret(tmp_path):
    path = tmp_path / "elsewhere" / "secret"
    path.parent.mkdir()
    path.write_text(SECRET)
    return path


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document, sort_keys=True, ensure_ascii=False) + "\n")


def claim(group, change, number=0):
    """Change a record as its author could: the index is made to fit it."""
    path = group / record_path(number)
    edit(path, change)
    records = {i: r for i, r in Group(group).records.items() if i != number}
    records[number] = parse(path.read_bytes(), path.name)[0]
    (group / "index.json").write_bytes(index_bytes(records.values()))


def declare(group, change):
    """Change what a group says it is, as its author could."""
    document = json.loads((group / "zarr.json").read_text())["attributes"]["topokit"]
    change(document)
    (group / "zarr.json").write_bytes(skeleton([], document)["zarr.json"])


def swap(group, name, content, number=0):
    """Put another object in the place of one, and its checksum into the record."""
    path = next(path for path in json.loads((group / record_path(number)).read_text())["objects"] if name in path)
    (group / path).write_bytes(content)
    claim(group, lambda d: d["objects"].update({path: hashlib.sha256(content).hexdigest()}), number)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# -- writing: a cut, a lock, a folder ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "key", ["/elsewhere/new", "../elsewhere/new", "points/../../elsewhere/new", "points/c.1.0.0.0"]
)
def test_a_cut_writes_what_is_its_own_and_nowhere_else(copy, tmp_path, secret, key):
    key = f"{tmp_path}{key}" if key.startswith("/") else key
    shutil.rmtree(copy / "labels")  # they would no longer be of this episode
    source = tmp_path / "copy" / key
    if not source.exists():  # where `../` reads
        source.write_text(SECRET)
    before, sha = files(tmp_path), hashlib.sha256(source.read_bytes()).hexdigest()
    claim(copy, lambda d: d["objects"].update({key: sha}))
    with pytest.raises(FormatError, match=r"records/00000000\.json.*names.*which is not its own"):
        Dataset(copy).cut([0], tmp_path / "cut")
    after = files(tmp_path)
    assert {name for name in {*before, *after} if before.get(name) != after.get(name)} == {
        "copy/index.json",
        "copy/records/00000000.json",
    }


@pytest.mark.parametrize("link", ["points/c.0.0.0.0", "points", "labels", "labels/full", "records", "held/zarr.json"])
def test_a_cut_copies_through_no_link(copy, tmp_path, link):
    shutil.move(copy / link, tmp_path / "moved")
    (copy / link).symlink_to(tmp_path / "moved")
    if link == "held/zarr.json":
        Dataset(copy).cut([0], tmp_path / "cut")  # what describes an array is made, not copied
        assert not list(p for p in (tmp_path / "cut").rglob("*") if p.is_symlink())
        return
    with pytest.raises(FormatError, match="or is reached by a link"):
        Dataset(copy).cut([0], tmp_path / "cut")
    assert not (tmp_path / "cut").exists()


@pytest.mark.parametrize("place", ["points/c.2.0.0.0", "labels/full/id/c.2.0.0"])
def test_a_cut_of_damage_writes_nothing(copy, tmp_path, place):
    content = bytearray((copy / place).read_bytes())
    content[40] ^= 1
    (copy / place).write_bytes(content)
    with pytest.raises(FormatError, match=f"{place}.*is damaged"):
        Dataset(copy).cut([0, 2], tmp_path / "cut")
    assert not (tmp_path / "cut").exists()


def test_a_cut_goes_to_a_store_and_comes_back(made, tmp_path):
    memory = fsspec.filesystem("memory")
    try:
        far = Dataset(made).cut([0, 2], "memory://cut")
        near = far.cut([0, 2], tmp_path / "cut")
        assert far.checksum() == near.checksum() == Dataset(made).cut([2, 0], tmp_path / "same").checksum()
        assert files(tmp_path / "cut") == files(tmp_path / "same")
        assert check_dataset("memory://cut") == []
        assert (far[2].points == Dataset(made)[2].points).all()
        with pytest.raises(ValueError, match="not an empty folder"):
            Dataset(made).cut([0], "memory://cut")
    finally:
        memory.rm("/cut", recursive=True)


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
@pytest.mark.parametrize("group", ["", "labels/full"])
def test_a_lock_that_is_none_is_refused(copy, secret, group, kind):
    lock = copy / group / ".lock"
    lock.unlink(missing_ok=True)
    {"link": lambda: lock.symlink_to(secret), "folder": lock.mkdir, "pipe": lambda: os.mkfifo(lock)}[kind]()
    make = partial(label_dataset, copy, options=OPTIONS) if group else partial(generate_dataset, TINY, copy, 3, SEED)
    with pytest.raises(OSError, match=r"\.lock: is .*remove it"):
        make(progress=False)
    assert secret.read_text() == SECRET


@pytest.mark.parametrize("link", ["timing.jsonl", "records", "id", "."])
def test_labels_are_written_through_no_link(copy, tmp_path, secret, link):
    (copy / "labels/full/records/00000001.json").unlink()
    (secret.parent / ".mine.part").write_text(SECRET)
    place = copy / "labels/full" / link
    shutil.move(place, tmp_path / "moved")
    place.symlink_to(secret if link == "timing.jsonl" else secret.parent)
    with without_dask(), pytest.raises(OSError, match="is a link"):
        label_dataset(copy, options=OPTIONS, progress=False)
    assert files(secret.parent) == {"secret": SECRET.encode(), ".mine.part": SECRET.encode()}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"episodes": 99999999999999999999}, "from 1 to 100,000,000"),
        ({"episodes": 100_000_001}, "from 1 to 100,000,000"),
        ({"episodes": 0}, "from 1 to"),
        ({"episodes": True}, "from 1 to"),
        ({"seed": 10**5000}, "seed must be a whole number"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"time_limit": float("nan")}, "time_limit"),
        ({"n_workers": 0}, "n_workers"),
        ({"config": {"simulation": {"frames": 10**12}}}, "room.frames"),
        ({"config": {"simulation": {"dt": 1e-300}}}, "room.frames"),
        ({"config": {"sizes": {"sheet": {"spacing": 1e-9}}}}, "spacing"),
        ({"config": {"sizes": {"sheet": {"width": 1e9}}}}, "sizes.sheet.width"),
        ({"config": {"cameras": 10**12}}, "cameras"),
        ({"config": {"cameras": 1, "n_observed": 10**12}}, "room.seen"),
    ],
)
def test_nothing_is_written_before_everything_is_checked(tmp_path, arguments, says):
    config = {"tasks": {"sheet-hook": 1}, **arguments.get("config", {})}

    def make():
        how = {"episodes": 1, "seed": 0, **arguments, "config": DatasetConfig.from_json(config)}
        generate_dataset(out=tmp_path, progress=False, **how)

    (tmp_path / ".mine.part").write_text(SECRET)
    with pytest.raises(ValueError, match=says):
        make()
    assert [path.name for path in tmp_path.rglob("*")] == [".mine.part"]


def test_a_folder_of_others_is_left_as_it_is(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text(SECRET)
    (tmp_path / ".film.mkv.part").write_text(SECRET)  # somebody else's download
    before = files(tmp_path)
    assert main(["generate", "--out", str(tmp_path), "--episodes", "99999999999999999999"]) == 2
    assert "from 1 to 100,000,000" in capsys.readouterr().err
    with pytest.raises(ValueError, match="holds other files"):
        generate_dataset(TINY, tmp_path, 1, SEED, progress=False)
    assert files(tmp_path) == before


def test_a_url_is_no_folder_to_write_to(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for make in (lambda: generate_dataset(TINY, "s3://bucket/data", 1, SEED), lambda: label_dataset("memory://data")):
        with pytest.raises(ValueError, match=r"a folder.*`Dataset.cut` writes"):
            make()
    assert list(tmp_path.iterdir()) == []


def test_an_episode_whose_record_was_lost_is_made_again(made, copy):
    (copy / record_path(1)).unlink()  # the index still knows it
    (copy / "labels/full" / record_path(2)).unlink()
    with without_dask():
        generate_dataset(TINY, copy, EPISODES, SEED, progress=False)
        label_dataset(copy, options=OPTIONS, progress=False)
    logs = ("timing.jsonl", "labels/full/timing.jsonl")
    assert {k: v for k, v in files(copy).items() if k not in logs} == {
        k: v for k, v in files(made).items() if k not in logs
    }


# -- reading: damage, and what a stranger declares ----------------------------------------------------------------------------


def test_reading_without_zarr_gives_what_zarr_reads(made):
    """Objects are unpacked from verified bytes; the arrays that they make are those of the format."""
    for folder in (made, DATA / "dataset"):
        for group in (Dataset(folder).group, Dataset(folder).labels("full")):
            arrays = {f.name: zarr.open_array(folder / group.prefix / f.name, mode="r") for f in group.fields}
            for number in Dataset(folder).episodes[:3].tolist():
                document = group.document(number)
                for name, found in decode(group, document).items():
                    wanted = arrays[name][(number, *map(slice, document["shapes"][name]))]
                    assert found.dtype == wanted.dtype
                    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", ["points", "observed", "actions", "held", "faces", "loops", "centre_line"])
@pytest.mark.parametrize("how", ["missing", "empty", "truncated", "flipped", "swapped"])
def test_damage_is_noticed_when_it_is_read(copy, name, how):
    documents = [Dataset(copy).document(i) for i in (0, 1)]
    mine, other = (next(p for p in d["objects"] if p.startswith(name)) for d in documents)
    path, content = copy / mine, (copy / mine).read_bytes()
    middle = len(content) // 2
    changed = {
        "empty": b"",
        "truncated": content[:middle],
        "flipped": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "swapped": (copy / other).read_bytes(),
    }
    if how == "swapped" and changed["swapped"] == content:
        changed["swapped"] = (copy / other).with_name("zarr.json").read_bytes()
    if how == "missing":
        path.unlink()
    else:
        path.write_bytes(changed[how])
    dataset = Dataset(copy)
    with pytest.raises(FormatError, match=f"{mine}: is {'missing' if how == 'missing' else 'damaged'}, of episode 0"):
        dataset[0]
    assert len(dataset[1]) == 20  # the others are whole


@pytest.mark.parametrize("name", ["id", "simplices", "values", "parameters"])
def test_damaged_labels_are_noticed_when_they_are_read(copy, name):
    document = Dataset(copy).labels("full").document(0)
    mine = next(p for p in document["objects"] if p.startswith(name))
    (copy / "labels/full" / mine).unlink()
    with pytest.raises(FormatError, match=f"labels/full/{mine}: is missing, of episode 0"):
        Dataset(copy).states(0, "full")
    with contextlib.nullcontext() if name == "parameters" else pytest.raises(FormatError, match="is missing"):
        WindowDataset(copy, history=2, horizon=2)[0]


def test_labels_of_another_episode_are_not_read(copy):
    claim(copy / "labels/full", lambda d: d.update(of="0" * 64))
    with pytest.raises(FormatError, match="of another episode than the one that is there now"):
        Dataset(copy).states(0, "full")
    with pytest.raises(FormatError, match="of another episode than the one that is there now"):
        WindowDataset(copy, history=2, horizon=2)[0]


def test_a_record_that_is_not_the_one_of_the_index_is_not_read(copy):
    dataset = Dataset(copy)
    assert len(dataset.records) == EPISODES  # the index is read
    edit(copy / record_path(0), lambda d: d["physics"].update(luck=1))
    for again in (dataset, Dataset(copy)):
        with pytest.raises(FormatError, match=r"records/00000000\.json: is damaged"):
            again[0]


@pytest.mark.parametrize("name", ["points", "faces", "observed"])
def test_what_an_object_declares_is_compared_with_its_field(copy, name):
    """A Blosc frame says how much it unpacks to, and how long it is; a shard where its chunks are."""
    original = next((copy / name).glob("c.0.*")).read_bytes()
    bombs = {
        "too large": Blosc(cname="zstd").encode(np.zeros(10**8, dtype=np.uint8)),
        "cut": original[: len(original) // 2],
        "nothing": b"",
        "noise": np.random.default_rng(0).bytes(500),
        "far": b"\xff" * 7 + b"\x7f" + original[8:],
        "index": original[:-36] + b"\x01" * 32 + original[-4:],
    }
    for content in bombs.values():
        swap(copy, f"{name}/", content)
        with memory() as peak:
            with pytest.raises(FormatError, match=rf"records/00000000\.json: does not fit what is there: .*{name}"):
                Dataset(copy)[0]
            assert peak() < 2e7


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.update(episodes=10**12), "episodes: Input should be less than or equal to 100000000"),
        (lambda d: d.update(episodes=10**400), "episodes"),
        (lambda d: d.update(episodes=-1), "episodes"),
        (lambda d: d.update(episodes="3"), "episodes"),
        (lambda d: d.pop("episodes"), "'episodes' is missing"),
        (lambda d: d.update(numbers=[]), "numbers"),
        (lambda d: d.update(numbers=[0, 10**12]), "numbers"),
        (lambda d: d.update(numbers=[1, 0]), "numbers"),
        (lambda d: d.update(room=[]), "room"),
        (lambda d: d["room"].update(frames=10**12), "room.frames"),
        (lambda d: d["room"].update(frames=17), "room.frames"),
        (lambda d: d["room"].update(vertices=10**12), "room.vertices"),
        (lambda d: d["room"].pop("faces"), "room.faces"),
        (lambda d: d.update(seed="0"), "seed"),
        (lambda d: d.update(config=[]), "config"),
        (lambda d: d["config"].update(tasks={}), "config.tasks"),
        (lambda d: d["config"].update(cameras="two"), "config.cameras"),
        (lambda d: d.update(versions=3), "versions"),
        (lambda d: d.update(version=2), "of version 2"),
        (lambda d: d.update(format="cake"), "format"),
        (lambda d: d.pop("format"), "format"),
    ],
)
def test_what_a_manifest_declares_is_checked_when_it_is_opened(copy, change, says):
    declare(copy, change)
    with pytest.raises(FormatError, match=says) as caught:
        Dataset(copy)
    assert "zarr.json" in str(caught.value)
    with pytest.raises(FormatError, match=says):
        check_dataset(copy)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.update(slots=10**12), "slots"),
        (lambda d: d.update(observation="nothing"), "observation"),
        (lambda d: d.update(n_points="many"), "n_points"),
        (lambda d: d.pop("options"), "options"),
    ],
)
def test_what_labels_declare_is_checked_when_they_are_opened(copy, change, says):
    declare(copy / "labels/full", change)
    with pytest.raises(FormatError, match=rf"labels/full/zarr\.json.*{says}"):
        Dataset(copy).labels("full")
    assert any(problem.where == "labels/full" for problem in check_dataset(copy))


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000,
        '{"attributes":' * 100_000,
        "[]",
        "3",
        "null",
        '{"attributes": []}',
        '{"attributes": {"topokit": []}}',
        "\0",
        "NaN",
        "9" * 5000,
        "\ud800",
    ],
)
@pytest.mark.parametrize("file", ["zarr.json", "index.json", "records/00000000.json", "labels/full/zarr.json"])
def test_json_of_any_kind_names_the_file(copy, file, content):
    (copy / file).write_bytes(content.encode(errors="surrogatepass"))
    with pytest.raises((FormatError, KeyError), match=file.replace("zarr.json", "").rstrip("/") or "zarr"):
        answer_of(copy)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.pop("objects"),
        lambda d: d.update(objects=[]),
        lambda d: d.pop("shapes"),
        lambda d: d["shapes"].pop("points"),
        lambda d: d["shapes"].update(points=[20, 10**12, 3]),
        lambda d: d["shapes"].update(points=[10**30, 9, 3]),
        lambda d: d["shapes"].update(points=[-1, 9, 3]),
        lambda d: d["shapes"].update(points=[]),
        lambda d: d["shapes"].update(points="all"),
        lambda d: d["shapes"].update(points=[20.0, 9, 3]),
        lambda d: d["shapes"].update(points=[20, 9]),
        lambda d: d["shapes"].update(held=[19]),
        lambda d: d.update(frames=10**12),
        lambda d: d.update(frames=None),
        lambda d: d.update(episode=[]),
        lambda d: d.update(episode=1),
        lambda d: d.update(status="fine"),
        lambda d: d.update(loops=[10**12]),
        lambda d: d.update(loops=3),
        lambda d: d.update(dt="long"),
        lambda d: d.update(dt=-1.0),
        lambda d: d.pop("dt"),
        lambda d: d.update(task={}),
        lambda d: d.pop("physics"),
    ],
)
def test_what_a_record_declares_is_compared_with_what_is_there(copy, change):
    """The record and the index that fits it are a stranger's; episode 0 is an error that names it."""
    edit(copy / record_path(0), change)
    with contextlib.suppress(FormatError):
        claim(copy, lambda d: None)
    (copy / "index.json").unlink()
    with memory() as peak:
        with pytest.raises(FormatError, match=r"records/00000000\.json|(points|held)/c\.0"):
            Dataset(copy)[0]
        assert peak() < 2e7


def test_ids_beyond_the_cloud_name_the_record(copy):
    labels = Dataset(copy).labels("full")
    fields = label_fields(32, 8)
    for name, value, says in (("simplices", 60000, "simplices"), ("id", 0, "")):
        arrays = {f.name: np.full((20, *f.shape[1:]), value if f.name == name else 1, f.dtype) for f in fields}
        for path, content in encode(fields, 0, arrays):
            swap(copy / "labels/full", path, content)
        if says:
            with pytest.raises(FormatError, match=r"labels/full/records/00000000\.json"):
                Dataset(copy).states(0, "full")
            with pytest.raises(FormatError, match=r"labels/full/records/00000000\.json"):
                WindowDataset(copy, history=2, horizon=2)[0]
    assert labels.manifest["slots"] == 8


def test_windows_are_counted_before_they_take_memory(copy):
    with pytest.raises(ValueError, match=r"33 windows.*528 bytes.*`memory`"):
        WindowDataset(copy, history=4, horizon=6, memory=500)
    assert len(WindowDataset(copy, history=4, horizon=6, memory=528)) == 33


@pytest.mark.parametrize("name", ["²²²²²²²²", "0000000a", "99999999", "-0000001"])
def test_names_that_are_no_records(copy, name):
    (copy / "records" / f"{name}.json").write_text("{}")
    (copy / "index.json").unlink()
    with contextlib.suppress(FormatError):
        assert len(Dataset(copy)) == EPISODES
    assert any(name in problem.where for problem in check_dataset(copy))


@pytest.mark.parametrize("path", ["zarr.json", "index.json", "records/00000000.json", "points/c.0.0.0.0"])
def test_what_is_no_file_is_not_waited_for(copy, path):
    (copy / path).unlink()
    os.mkfifo(copy / path)
    with pytest.raises(OSError, match=f"{path}.*no regular file"):
        Dataset(copy)[0]


def test_labels_have_a_name(made):
    for name in ("../full", "", "full/../full", "a\0b", "."):
        with pytest.raises(ValueError, match="letters, digits"):
            Dataset(made).labels(name)


@pytest.mark.parametrize("content", [b"PK\x03\x04 and no more", b""])
def test_a_damaged_zip_is_a_sentence(tmp_path, content):
    (tmp_path / "bad.zip").write_bytes(content)
    with pytest.raises(FormatError, match=r"bad\.zip.*damaged"):
        Dataset(f"zip://::{tmp_path}/bad.zip")


def test_a_damaged_member_of_a_zip_is_a_sentence(made, tmp_path):
    path = shutil.make_archive(str(tmp_path / "data"), "zip", made)
    with zipfile.ZipFile(path) as archive:
        entry = archive.getinfo("points/c.0.0.0.0")
    content = bytearray((tmp_path / "data.zip").read_bytes())
    content[entry.header_offset + 200] ^= 255
    (tmp_path / "data.zip").write_bytes(content)
    with pytest.raises(FormatError, match=r"points/c\.0\.0\.0\.0.*damaged"):
        Dataset(f"zip://::{path}")[0]


@pytest.mark.parametrize("missing", ["fsspec", "numcodecs", "zarr"])
@pytest.mark.parametrize("python", [(3, 10), (3, 13)])
def test_what_reading_and_checking_need_is_named(missing, python):
    """And on Python 3.10 that Zarr needs a later one: there pip passes over it without a word."""
    code = "import sys; from topokit.data import Dataset, check_dataset; import pydantic.dataclasses, fsspec, asyncio\n"
    code += f"sys.modules[{missing!r}], sys.version_info, where = None, {python}, {str(DATA / 'dataset')!r}\n"
    code += "Dataset(where)[0], check_dataset(where)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    later = ", on Python 3.11 or later" if python < (3, 11) else ""
    wanted = f"ImportError: datasets need {missing}: pip install 'topokit[data]'{later}"
    assert done.stderr.splitlines()[-1] == wanted


@pytest.mark.parametrize(
    "unsign", [lambda d: d["attributes"].pop("sha256"), lambda d: d["attributes"].update(sha256="")]
)
@pytest.mark.parametrize("group", ["", "labels/full/"])
def test_a_group_without_its_checksum_is_not_read(copy, group, unsign):
    edit(copy / f"{group}zarr.json", unsign)
    with pytest.raises(FormatError, match=rf"{group}zarr\.json"):
        Dataset(copy).labels("full")


def test_an_index_without_its_checksum_is_not_read(copy):
    edit(copy / "index.json", lambda d: d.pop("checksum"))
    with pytest.raises(FormatError, match=r"index\.json: a damaged index"):
        Dataset(copy)


def test_an_observation_of_another_length_names_the_record(copy):
    """As long as the record says that it is; the cloud that it points into is shorter."""
    fields = {f.name: f for f in Dataset(copy).group.fields}
    ids = np.zeros((3, fields["observed"].shape[1]), fields["observed"].dtype)
    for path, content in encode([fields["observed"]], 0, {"observed": ids}):
        swap(copy, path, content)
    claim(copy, lambda d: d["shapes"].update(observed=list(ids.shape)))
    for read in (lambda: Dataset(copy)[0], lambda: WindowDataset(copy, history=2, horizon=2)[0]):
        with pytest.raises(FormatError, match=r"records/00000000\.json"):
            read()


# -- every byte -------------------------------------------------------------------------------------------------------------


def test_a_flipped_byte_is_noticed_or_harmless(made, tmp_path):
    """A seeded sample here; `python tests/flip_bytes.py` flips every byte."""
    folder, rng = shutil.copytree(made, tmp_path / "flipped"), np.random.default_rng(0)
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in ("timing.jsonl", ".lock"))
    whole, noticed = answer_of(folder), 0
    for path in paths:
        place, bit = int(rng.integers(path.stat().st_size)), int(rng.integers(8))
        noticed += notice(folder, path, place, 1 << bit, answer_of, whole)
    assert noticed > len(paths) / 2


# -- SIGTERM ------------------------------------------------------------------------------------------------------


def test_sigterm_leaves_no_temporary_folder(tmp_path, monkeypatch):
    config, temporary = tmp_path / "config.json", tmp_path / "temporary"
    config.write_text(json.dumps(TINY.to_json()))
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    out = tmp_path / "data"
    process = command("generate", "--config", config, "--out", out, "--episodes", "50", "--workers", "1", "--quiet")
    wait_until(lambda: len(list(out.glob("records/*.json"))) > 0, process)
    assert list(temporary.iterdir())
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "the same command goes on" in said
    left = {path.name for path in temporary.rglob("*")}  # of Dask, once and for all that ever run
    assert left <= {"dask-scratch-space", "purge.lock", "global.lock"}
    assert not list(out.rglob("*.part"))


# -- archives and configurations ------------------------------------------------------------------------------------------------


def test_the_kind_of_an_archive_is_looked_at_before_its_arrays(tmp_path):
    path = save_archive(tmp_path / "a.npz", "topokit-other", {}, {"x": np.zeros(2**23)})
    with memory() as peak:
        with pytest.raises(FormatError, match="holds a topokit other, not a topokit episode"):
            load_archive(path, "topokit-episode")
        assert peak() < 2e6


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(_archive, "FREE", 2**20)
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, json=np.zeros(3, np.uint8), x=np.zeros(2**24, dtype=np.uint8))
    with memory() as peak:
        with pytest.raises(FormatError, match=r"bomb\.npz.*bytes claim to hold 16777"):
            load_archive(path, "topokit-episode")
        assert peak() < 2e6


@pytest.mark.parametrize("text", ["[" * 100_000 + "]" * 100_000, "[1, 2]", "nothing", "null"])
def test_the_document_of_an_archive_of_any_kind(tmp_path, text):
    np.savez(tmp_path / "a.npz", json=np.frombuffer(text.encode(), dtype=np.uint8))
    with pytest.raises(FormatError, match="topokit did not write"):
        load_archive(tmp_path / "a.npz", "topokit-episode")


def test_a_pipe_or_a_device_is_no_archive(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    for path in (tmp_path / "pipe.npz", "/dev/null"):
        with pytest.raises(FileNotFoundError, match="a device or a pipe, not a file"):
            load_archive(path, "topokit-episode")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("c.json", "[" * 100_000, "not JSON"),
        ("c.json", '{"tasks":' * 100_000, "not JSON"),
        ("c.json", '{"n_observed": NaN}', "n_observed"),
        ("c.json", '{"n_observed": 1e999}', "n_observed"),
        ("c.json", "\x00", "not JSON"),
        ("c.json", "[" + "1," * 10**6 + "1]", "named entries"),
        ("c.json", '{"n_observed": "1979-05-27"}', "n_observed"),
        ("c.json", '{"n_observed": ' + "9" * 5000 + "}", "not JSON"),
    ],
)
def test_a_configuration_of_any_kind_names_the_file(tmp_path, name, text, says):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"{name}.*{says}") as caught:
        load(DatasetConfig, path)
    assert len(str(caught.value)) < 1000
