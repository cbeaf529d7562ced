"""The module that `torch_module` makes. Importing this file imports torch."""

import torch

from planspace.embed.embedding import Embedding
from planspace.embed.float32_encoder import Layer, float32_encoder
from planspace.physics.quaternion import rotation_columns


class _Linear(torch.nn.Module):
    """A linear layer. It is no `torch.nn.Linear`, because Stable-Baselines3 initialises all of those anew."""

    def __init__(self, layer: Layer):
        super().__init__()
        weight, bias = layer
        self.weight = torch.nn.Parameter(torch.tensor(weight))
        self.bias = torch.nn.Parameter(torch.tensor(bias))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.linear(x, self.weight, self.bias)


class TorchEncoder(torch.nn.Module):
    """The encoder of an embedding: states [*batch, state] to z [*batch, z]."""

    straight: torch.Tensor
    circular: torch.Tensor
    quaternions: torch.Tensor
    mean: torch.Tensor

    def __init__(self, embedding: Embedding, trainable: bool = False):
        super().__init__()
        arrays = float32_encoder(embedding)
        self._inputs = embedding.inputs
        self._has_angles = len(arrays.circular) > 0
        self._num_quaternions = arrays.quaternions.shape[1]
        self.state_dim, self.z_dim = embedding.state_dim, embedding.z_dim
        self.register_buffer("straight", torch.tensor(arrays.straight))
        self.register_buffer("circular", torch.tensor(arrays.circular))
        columns = torch.tensor(arrays.quaternions.ravel())
        self.register_buffer("quaternions", columns, persistent=False)  # keys of saved agents stay the same
        self.register_buffer("mean", torch.tensor(arrays.mean))
        self.layers = torch.nn.ModuleList(map(_Linear, (*arrays.hidden, arrays.mu)))
        self.requires_grad_(trainable)

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Compute z, in the type of the module's weights.

        Raises:
            PlanspaceError: the states have the wrong number of columns.
        """
        self._inputs.check_shape(states.shape)
        x = states.to(self.mean.dtype)
        if self._has_angles or self._num_quaternions:
            parts = [x.index_select(-1, self.straight)]
            if self._has_angles:
                angles = x.index_select(-1, self.circular)
                parts += [angles.sin(), angles.cos()]
            if self._num_quaternions:
                numbers = x.index_select(-1, self.quaternions).split(self._num_quaternions, -1)
                parts += rotation_columns(*numbers)
            x = torch.cat(parts, -1)
        x = x - self.mean
        for i, layer in enumerate(self.layers):
            x = layer(x.relu() if i else x)
        return x
