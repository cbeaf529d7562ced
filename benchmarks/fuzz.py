"""Search for files that crash planspace instead of being read or rejected (extra `fuzz`).

    python benchmarks/fuzz.py [--seconds N] [--only problem,model,manifest,embedding,policies,json,csv]

Atheris mutates problem files, models and plans byte by byte, guided by the lines of planspace that they
reach. It mutates the descriptions of datasets, embeddings and policies value by value and gives each a valid
checksum. The output is the number of files tried. A file that causes an error other than `PlanspaceError` is
saved, and the exit code is 1.
"""

import argparse
import contextlib
import importlib
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
GOLDEN = sorted((ROOT / "tests" / "golden").glob("*/expected.json"))[-1].parent
TARGETS = ("problem", "model", "manifest", "embedding", "policies", "json", "csv")
INSTRUMENTED = (
    "storage.json_files",
    "demos.convert",
    "embed.saved_embedding",
    "tasks.problem_file",
    "rl.saved_policy",
)
"""Modules that are imported with instrumentation; they import the others."""
SEED_JSON = b'{"state_dims": ["x", "control", "time"], "path": [[0, 1, 0,], [1, 0, 0.5]]}'
SEED_CSV = b"time,x,control\n0,1,2\n0.5,2,3\n"
Probe = Callable[[bytes], None]


def fuzz(target: str, seconds: int, out: Path) -> None:
    """Fuzz one target. Run this in a separate process, because libFuzzer never returns."""
    import atheris

    with atheris.instrument_imports(include=["planspace"]):
        for module in INSTRUMENTED:
            importlib.import_module(f"planspace.{module}")
    from planspace.errors import PlanspaceError

    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").exists() else None))
    probe, seeds = make_probe(target, folder)

    def probe_one(data: bytes) -> None:
        with contextlib.suppress(PlanspaceError), contextlib.redirect_stderr(io.StringIO()):
            probe(data)

    corpus = out / f"{target}-corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds):
        (corpus / f"seed-{number}").write_bytes(seed)
    limits = [f"-max_total_time={seconds}", "-timeout=20", "-rss_limit_mb=4096", "-max_len=8192"]
    atheris.Setup([target, *limits, f"-artifact_prefix={out}/{target}-", str(corpus)], probe_one)
    atheris.Fuzz()


def make_probe(target: str, folder: Path) -> tuple[Probe, list[bytes]]:
    """A function that reads a file with given bytes, and the files to start from."""
    from planspace.demos.load import load_demos
    from planspace.embed.saved_embedding import load_embedding
    from planspace.mjcf.assets import ASSETS
    from planspace.mjcf.read import read_model
    from planspace.mjcf.source import ModelFile
    from planspace.rl.saved_policy import load_policy
    from planspace.tasks.problem_file import load_problem

    problem = (ASSETS / "cartpole-swingup.yaml").read_bytes()
    models = sorted(ASSETS.glob("*.xml"))
    if target == "problem":
        for file in models:
            shutil.copy(file, folder)
        return lambda data: load_problem(str(written(folder / "p.yaml", data))) and None, [problem]
    if target == "model":
        seeds = [file.read_bytes() for file in models]
        return lambda data: read_model(ModelFile(written(folder / "m.xml", data))) and None, seeds
    if target in ("json", "csv"):
        return importer(folder, target), [SEED_JSON if target == "json" else SEED_CSV]
    readers = {
        "manifest": ("demos", "manifest.json", load_demos),
        "embedding": ("embedding", "embedding.json", load_embedding),
        "policies": ("run", "policies.json", load_policy),
    }
    name, file, read = readers[target]
    shutil.copytree(GOLDEN / name, folder / name)
    return sealed(folder / name / file, lambda: read(folder / name)), [bytes(range(64))]


def written(file: Path, data: bytes) -> Path:
    file.write_bytes(data)
    return file


def importer(folder: Path, ending: str) -> Probe:
    from planspace.demos.convert import import_demos
    from planspace.demos.load import load_demos
    from planspace.demos.recording import ImportOptions

    def probe(data: bytes) -> None:
        file, out = written(folder / f"plan_0.{ending}", data), folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        import_demos([str(file)], out, None, ImportOptions())
        load_demos(out)  # an imported dataset can be read

    return probe


def sealed(file: Path, read: Callable[[], Any]) -> Probe:
    """A function that changes values of a description as its bytes determine, with a valid checksum."""
    import atheris

    from planspace.storage.json_files import read_sealed, write_sealed

    whole = read_sealed(file)

    def probe(data: bytes) -> None:
        given = atheris.FuzzedDataProvider(data)
        text = json.loads(json.dumps(whole))
        for _ in range(given.ConsumeIntInRange(1, 4)):
            change_one(text, given)
        write_sealed(file, text)
        read()

    return probe


def change_one(text: Any, given: Any) -> None:
    """Replace or delete one value at a random depth."""
    while True:
        keys = sorted(text) if isinstance(text, dict) else list(range(len(text)))
        if not keys:
            return
        key = keys[given.ConsumeIntInRange(0, len(keys) - 1)]
        if isinstance(text[key], dict | list) and text[key] and given.ConsumeBool():
            text = text[key]
            continue
        if given.ConsumeIntInRange(0, 4) == 0:
            del text[key]
        else:
            text[key] = value(given)
        return


def value(given: Any, depth: int = 0) -> Any:
    kind = given.ConsumeIntInRange(0, 8)
    if kind == 0:
        return None
    if kind == 1:
        return given.ConsumeBool()
    if kind == 2:
        return given.ConsumeIntInRange(-3, 12)
    if kind == 3:
        return given.ConsumeInt(8)
    if kind == 4:
        return given.ConsumeRegularFloat()
    if kind == 5:
        return given.ConsumeUnicodeNoSurrogates(12)
    if kind == 6:
        return "../" * given.ConsumeIntInRange(1, 3) + "etc/passwd"
    if depth > 3:
        return []
    inner = [value(given, depth + 1) for _ in range(given.ConsumeIntInRange(0, 3))]
    return inner if kind == 7 else {str(i): x for i, x in enumerate(inner)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=int, default=600, help="time for all targets together")
    parser.add_argument("--only", default=",".join(TARGETS))
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder for bad files")
    parser.add_argument("--one", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    out = options.out.absolute()
    if options.one:
        fuzz(options.one, options.seconds, out)
    names = options.only.split(",")
    print("command: python benchmarks/fuzz.py", " ".join(sys.argv[1:]))
    failed = []
    for name in names:
        words = ["--one", name, "--seconds", str(max(1, options.seconds // len(names))), "--out", str(out)]
        done = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, check=False)
        tried = re.findall(r"^(?:Done (\d+) runs|#(\d+)\b)", done.stderr, re.MULTILINE)
        number = next((a or b for a, b in reversed(tried)), "0")
        print(
            f"{name}: {number} files tried, {'no error' if done.returncode == 0 else 'ERROR FOUND'}",
            flush=True,
        )
        if done.returncode != 0:
            failed.append(name)
            print(done.stderr[-3000:] + done.stdout[-1500:])
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
