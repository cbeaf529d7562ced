"""An embedding's encoder as a PyTorch module (extra `torch`)."""

from typing import TYPE_CHECKING

from planspace.embed.embedding import Embedding
from planspace.errors import PlanspaceError, install_command

if TYPE_CHECKING:
    import torch

    from planspace.embed.torch_encoder import TorchEncoder


def torch_module(
    embedding: Embedding, device: "str | torch.device | None" = None, trainable: bool = False
) -> "TorchEncoder":
    """Make a `torch.nn.Module` that computes z from states on its device: `Embedding.encode` in float32.

    Args:
        embedding: the embedding; its decoder is not used.
        device: where the module's arrays are, such as `"cuda"`; None is the default device of PyTorch.
        trainable: let optimisers change the weights. By default they are frozen: gradients pass through to
            the states only.

    Returns:
        The module. It maps states [..., state] to z [..., z]; `state_dim` and `z_dim` are its sizes.

    Raises:
        PlanspaceError: PyTorch is not installed.
    """
    try:
        from planspace.embed.torch_encoder import TorchEncoder
    except ImportError as error:
        raise PlanspaceError(
            f"torch_module needs PyTorch: {install_command('torch')}. On a machine without a GPU, install "
            "the CPU build of torch first."
        ) from error
    module = TorchEncoder(embedding, trainable)
    return module if device is None else module.to(device)
