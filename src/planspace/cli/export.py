"""`planspace export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Export:
    """Write an embedding's encoder for programs that have no Python; needs the extra `onnx`."""

    embedding: Positional[Annotated[Path, arg(metavar="EMBEDDING")]]
    """An embedding's folder."""
    out: Positional[Annotated[Path, arg(metavar="FILE")]]
    """The file to make."""
    to: Literal["onnx"] = "onnx"
    """onnx: `state` [batch, n] to `mu` and `sigma` [batch, z] of q(z|x), all float32."""

    def __call__(self) -> None:
        """Exports it."""
        from planspace.embed.embedding import load_embedding
        from planspace.embed.export import export_onnx

        export_onnx(load_embedding(self.embedding), self.out)
        print(self.out)
