import json
from pathlib import Path

import numpy as np
import pytest

from planspace.errors import PlanspaceError
from tests.demos.formats.minari_datasets import NAME, load, make_plain


def external_link(group, elsewhere: Path) -> None:
    import h5py

    group["observations"] = h5py.ExternalLink(str(elsewhere), "secret")


def soft_link(group, elsewhere: Path) -> None:
    import h5py

    group["observations"] = h5py.SoftLink("/episode_0/actions")


def two_names(group, elsewhere: Path) -> None:
    group["observations"] = group["actions"]


def external_array(group, elsewhere: Path) -> None:
    group.create_dataset("observations", (3, 3), "f4", external=[(str(elsewhere), 0, 36)])


def virtual_array(group, elsewhere: Path) -> None:
    import h5py

    layout = h5py.VirtualLayout((3, 3), "f4")
    layout[:] = h5py.VirtualSource(str(elsewhere), "secret", (3, 3))
    group.create_virtual_dataset("observations", layout)


def huge_array(group, elsewhere: Path) -> None:
    group.create_dataset("observations", (10**11, 3), "f4", chunks=(1000, 3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external_link, "is a link"),
        (soft_link, "is a link"),
        (two_names, "has two names"),
        (external_array, "keeps its numbers in another file"),
        (virtual_array, "keeps its numbers in another file"),
        (huge_array, "makes its episode larger than .* bytes, the most that can be read"),
    ],
)
def test_links_and_huge_arrays_in_hdf5_are_refused(change, message: str, minari, tmp_path: Path) -> None:
    import h5py

    make_plain(minari)
    load(tmp_path)
    with h5py.File(tmp_path / "secret.hdf5", "w") as secret:
        secret["secret"] = np.full((3, 3), 42, dtype=np.float32)
    file = tmp_path / "minari" / NAME / "data" / "main_data.hdf5"
    with h5py.File(file, "a") as opened:
        del opened["episode_0/observations"]
        change(opened["episode_0"], tmp_path / "secret.hdf5")
    with pytest.raises(PlanspaceError, match=f"{file}: 'episode_0/.*' {message}"):
        load(tmp_path)


def test_exponentially_nested_groups_are_refused(minari, tmp_path: Path) -> None:
    import h5py

    make_plain(minari)
    with h5py.File(tmp_path / "minari" / NAME / "data" / "main_data.hdf5", "a") as opened:
        group = opened["episode_0"].create_group("infos")
        for _ in range(60):  # 2^60 paths to the innermost group
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
    with pytest.raises(PlanspaceError, match="'episode_0/infos/a' has two names"):
        load(tmp_path)


@pytest.mark.parametrize("name", ["data", "data/metadata.json", "data/main_data.hdf5"])
def test_links_to_other_folders_are_refused(name: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    (tmp_path / "minari").rename(tmp_path / "other disk")
    (tmp_path / "minari").symlink_to(tmp_path / "other disk")
    load(tmp_path)
    path = tmp_path / "minari" / NAME / name
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PlanspaceError, match=f"{path} is a link to {tmp_path / 'elsewhere'}; replace it"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "observation_space",
            '{"type": "Tuple", "subspaces": [' * 900 + "]}" * 900,
            "cannot read .*recursion",
        ),
        ("observation_space", '{"type": "Box"}', "cannot read .*shape"),
        ("env_spec", "[" * 100_000, "cannot read .*recursion"),
        ("total_episodes", 10**11, "has an invalid number of episodes"),
        ("total_episodes", None, "has an invalid number of episodes"),
        ("total_episodes", 7, "cannot read .*episode_1"),
    ],
)
def test_invalid_metadata_are_refused(key: str, value, message: str, minari, tmp_path: Path) -> None:
    make_plain(minari)
    file = tmp_path / "minari" / NAME / "data" / "metadata.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), key: value}))
    with pytest.raises(PlanspaceError, match=message):
        load(tmp_path)
