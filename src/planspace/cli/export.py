"""`planspace export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Export:
    """Export the encoder of an embedding for programs without Python.

    This needs the extra `onnx`.
    """

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding folder."""
    out: Positional[Annotated[Path, arg(metavar="FILE")]]
    """The file to write."""
    to: Literal["onnx"] = "onnx"
    """The format. onnx maps `state` [batch, state] to `mu` and `sigma` [batch, z] of q(z|x), all float32."""

    def __call__(self) -> None:
        """Export the encoder."""
        from planspace.embed.export import export_onnx
        from planspace.embed.saved_embedding import load_embedding

        export_onnx(load_embedding(self.embedding), self.out)
        print(self.out)
