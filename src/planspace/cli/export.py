"""`planspace export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Export:
    """Export the encoder of an embedding for programs without Python.

    This needs the extra `onnx`. In Python, `planspace.torch_module` and `planspace.jax_function` give the
    encoder to PyTorch and JAX.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding folder, or the name of a ready-made one."""
    out: Positional[Annotated[Path, arg(metavar="FILE")]]
    """The file to write. Its suffix selects the format: .onnx."""
    to: Literal["onnx"] | None = None
    """The format, for any suffix. onnx maps `state` [batch, state] to `mu` and `sigma` [batch, z] of q(z|x),
    all float32."""

    def __call__(self) -> None:
        """Export the encoder."""
        from planspace.embed.export import export_onnx
        from planspace.embed.saved_embedding import load_embedding
        from planspace.errors import UsageError

        if self.to is None and self.out.suffix != ".onnx":
            raise UsageError(
                f"{self.out} has the suffix {self.out.suffix!r}, which is not a known format. Name the file "
                "NAME.onnx; for PyTorch and JAX, use planspace.torch_module and planspace.jax_function."
            )
        export_onnx(load_embedding(self.embedding), self.out)
        print(self.out)
