import subprocess
import sys

import jax
import mujoco

import planspace
from planspace.storage.provenance import Provenance


def test_versions_are_those_of_the_imported_libraries() -> None:
    assert Provenance.current("mujoco", "jax").plain() == {
        "planspace": planspace.__version__,
        "mujoco": mujoco.__version__,
        "jax": jax.__version__,
    }


def test_only_libraries_that_matter_are_recorded() -> None:
    assert Provenance.current().plain() == {"planspace": planspace.__version__}
    assert list(Provenance.current("mujoco").plain()) == ["planspace", "mujoco"]


def test_no_library_is_imported() -> None:
    code = "import sys; from planspace.storage.provenance import Provenance; Provenance.current('jax'); "
    code += "print([m for m in ('jax', 'mujoco') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
