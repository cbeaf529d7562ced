"""The Hugging Face hub, with a stand-in for its client; nothing here uses the network."""

import inspect
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planspace as ps
from planspace.cli import main
from planspace.errors import PlanspaceError, UsageError

hub = pytest.importorskip("huggingface_hub", reason="needs the extra hub")
REAL_CLIENT = hub.HfApi


class Server:
    """A hub that keeps the files of each commit; its methods have the signatures of the real client."""

    def __init__(self, root: Path):
        self.root, self.heads, self.calls = root, {}, []
        root.mkdir()

    def __getattr__(self, name: str) -> Any:
        signature = inspect.signature(getattr(REAL_CLIENT, name))

        def call(*args: Any, **options: Any) -> Any:
            bound = signature.bind(self, *args, **options).arguments
            self.calls.append(name)
            return getattr(self, f"do_{name}")(**{k: v for k, v in bound.items() if k != "self"})

        return call

    def do_create_repo(self, repo_id: str, repo_type: str, private: bool, exist_ok: bool) -> None:
        assert exist_ok and not private

    def files(self, repo_id: str, repo_type: str, revision: str | None = None) -> Path:
        commit = revision or self.heads.get((repo_id, repo_type), "none")
        return self.root / repo_type / repo_id / commit

    def do_list_repo_files(self, repo_id: str, repo_type: str, revision: str | None = None) -> list[str]:
        folder = self.files(repo_id, repo_type, revision)
        return [
            ".gitattributes",
            *(f.relative_to(folder).as_posix() for f in folder.rglob("*") if f.is_file()),
        ]

    def do_upload_folder(
        self, repo_id: str, repo_type: str, folder_path: Path, allow_patterns: list, **_: Any
    ):
        commit = f"{len(self.heads):040x}"
        self.heads[repo_id, repo_type] = commit
        for name in allow_patterns:
            target = self.files(repo_id, repo_type) / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder_path / name, target)
        return type("CommitInfo", (), {"oid": commit})

    def do_snapshot_download(
        self, repo_id: str, repo_type: str, revision: str, local_dir: Path, allow_patterns: list
    ) -> None:
        for name in allow_patterns:
            target = local_dir / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.files(repo_id, repo_type, revision) / name, target)


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Server:
    made = Server(tmp_path / "hub")
    monkeypatch.setattr(hub, "HfApi", lambda: made)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return made


def test_an_embedding_is_pushed_and_loaded_by_its_address(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, embedding = tmp_path / "embedding", ps.load_embedding("cartpole-swingup")
    embedding.save(folder)
    for name in ("README.md", "log.jsonl", "config.json", "weights.pkl"):
        (folder / name).write_text("{}")
    assert main(["push", str(folder), "me/cart"]) == 0
    address = capsys.readouterr().out.strip()
    assert address == f"hf://me/cart@{0:040x}"
    stored = {file.name for file in server.files("me/cart", "model").iterdir()}
    assert stored == {"embedding.json", "embedding.safetensors", "README.md"}
    states = np.ones((3, embedding.state_dim))
    np.testing.assert_array_equal(ps.load_embedding(address).encode(states), embedding.encode(states))
    count = len(server.calls)
    assert ps.load_embedding(Path(address)).hash == embedding.hash  # as the command line passes it
    assert len(server.calls) == count  # kept on this machine
    assert ps.pull_from_hub("me/cart", f"{0:040x}").parent.name == "model--me--cart"


def test_plans_are_a_dataset_and_their_log_stays_here(server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "plans"
    demos = ps.load_demos("cartpole-swingup")
    demos.save(folder)
    (folder / "log.jsonl").write_text("{}")
    address = ps.push_to_hub(folder, "me/plans")
    assert address.startswith("hf://datasets/me/plans@")
    assert ps.load_demos(address).hash == demos.hash


def test_policies_bring_their_embedding(server: Server) -> None:
    from planspace.storage.ready_made import POLICY, find_folder

    policy = ps.load_policy("cartpole-swingup")
    address = ps.push_to_hub(find_folder("cartpole-swingup", POLICY), "me/policy")
    pulled = ps.load_policy(address)
    assert pulled.seed == policy.seed and ps.load_embedding(pulled.embedding).hash
    assert main(["play", address, "--episodes", "1"]) == 0


@pytest.mark.parametrize("name", ["model.pkl", "code.py", "pytorch_model.bin", "a/b/c.json", "../x.json"])
def test_a_repository_with_other_files_is_refused(
    name: str, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ps.load_embedding("cartpole-swingup").save(tmp_path / "embedding")
    address = ps.push_to_hub(tmp_path / "embedding", "me/cart")
    listed = [*server.do_list_repo_files("me/cart", "model"), name]
    monkeypatch.setattr(server, "do_list_repo_files", lambda **_: listed)
    with pytest.raises(
        PlanspaceError, match=r"me/cart on the hub holds .*; only safetensors, JSON and README"
    ):
        ps.load_embedding(address)
    assert "snapshot_download" not in server.calls
    with pytest.raises(PlanspaceError, match="me/cart on the hub holds"):
        ps.push_to_hub(tmp_path / "embedding", "me/cart")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("hf://me/cart", "an address on the hub is hf://owner/name@commit, got 'hf://me/cart'"),
        ("hf://me/cart@main", "me/cart: the revision must be the hash of a commit .* got 'main'"),
        (Path("hf://cart@main"), "an address on the hub is hf://owner/name@commit, got 'hf://cart@main'"),
    ],
)
def test_an_address_without_a_commit_is_refused(address: Path | str, message: str, server: Server) -> None:
    with pytest.raises(UsageError, match=message):
        ps.load_embedding(address)
    assert not server.calls


def test_what_cannot_be_pushed_is_refused(server: Server, tmp_path: Path) -> None:
    ps.load_embedding("cartpole-swingup").save(tmp_path / "embedding")
    with pytest.raises(UsageError, match="a repository on the hub is owner/name, got 'cart'"):
        ps.push_to_hub(tmp_path / "embedding", "cart")
    with pytest.raises(UsageError, match="is not an embedding, a dataset of plans or a training run"):
        ps.push_to_hub(tmp_path, "me/cart")
    description = tmp_path / "embedding/embedding.json"
    description.write_text(json.dumps(json.loads(description.read_text()) | {"z_dim": 4}))
    with pytest.raises(PlanspaceError, match="does not match its own checksum"):
        ps.push_to_hub(tmp_path / "embedding", "me/cart")
    assert not server.calls


def test_a_hub_that_does_not_answer_is_one_line(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(**_: Any) -> None:
        raise ConnectionError("Name or service\nnot known")

    monkeypatch.setattr(server, "do_list_repo_files", fail)
    address = f"hf://me/cart@{7:040x}"
    assert main(["measure", address, "cartpole-swingup"]) == 1
    said = capsys.readouterr().err
    assert (
        said.count("\n") == 1 and "cannot pull me/cart (ConnectionError: Name or service not known)" in said
    )
    assert "HF_HUB_OFFLINE" in said
    assert "cannot pull me/cart (ConnectionError: Name or service not known)" in said
    assert not any(file.is_file() for file in (tmp_path / "cache").rglob("*"))


def test_what_the_hub_answers_is_passed_on(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = hub.errors.HfHubHTTPError.__new__(hub.errors.HfHubHTTPError)
    refusal.args = ("404 Client Error. Repository Not Found",)

    def fail(**_: Any) -> None:
        raise refusal

    monkeypatch.setattr(server, "do_list_repo_files", fail)
    with pytest.raises(PlanspaceError, match="cannot pull me/cart: the hub refused it"):
        ps.pull_from_hub("me/cart", f"{7:040x}")


def test_without_the_package_its_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "huggingface_hub", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(PlanspaceError, match=r"the hub needs huggingface_hub: pip install .*\[hub\]'"):
        ps.pull_from_hub("me/cart", f"{7:040x}")
