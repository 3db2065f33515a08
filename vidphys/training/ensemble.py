"""Several models of one architecture computed side by side, one for each seed.

Weights are stacked along a first axis and every function of one model is mapped over it, so that
training or rolling ten seeds is one computation. No member sees another's weights or data.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn
from torch.func import functional_call, stack_module_state, vmap
from torch.utils import _pytree as pytree

from dynamics import Parameters, PhaseState
from vidphys.placement import device_of
from vidphys.training.segments import Segments

Member = TypeVar("Member", bound=nn.Module)
STATIC = (int, float, str, bool, type(None))


def register(kind: type) -> None:
    """Let a dataclass of tensors pass through mapped functions; numbers in it stay as they are."""

    def flatten(x: Any) -> tuple[list[Any], Any]:
        values = {f.name: getattr(x, f.name) for f in fields(x)}
        moving = {k: v for k, v in values.items() if not isinstance(v, STATIC)}
        rest = {k: v for k, v in values.items() if isinstance(v, STATIC)}
        return list(moving.values()), (tuple(moving), tuple(rest.items()))

    def restore(values: Any, context: Any) -> Any:
        names, rest = context
        x: Any = object.__new__(kind)  # a mapped leaf may stand in for a tensor: nothing is checked
        for name, value in [*zip(names, values, strict=True), *rest]:
            object.__setattr__(x, name, value)
        return x

    assert is_dataclass(kind)
    pytree.register_pytree_node(kind, flatten, restore)


for _kind in (PhaseState, Parameters, Segments):
    register(_kind)


class Ensemble(nn.Module, Generic[Member]):
    """Stacked weights of models that differ in nothing but their weights and buffers.

    Args:
        members: one for each seed, at least one.
    """

    def __init__(self, members: Sequence[Member]) -> None:
        super().__init__()
        weights, buffers = stack_module_state(list(members))
        self.weights = nn.ParameterDict({_mangled(k): v.detach() for k, v in weights.items()})
        self.buffer_names = tuple(buffers)
        for name, value in buffers.items():
            self.register_buffer(_mangled(name), value)
        # A plain list hides the template from this module's own parameters.
        self._template = [copy.deepcopy(members[0])]

    def __len__(self) -> int:
        return len(next(iter(self._state().values())))

    def map(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """``function(member, *its share of each argument)`` for all members at once.

        Args:
            function: of one member; whatever random numbers it draws differ between members.
            arguments: tensors, or dataclasses of tensors, stacked over members.
        """
        call = _Call(self._template[0], function)
        leaves, spec = pytree.tree_flatten(arguments)
        form: list[Any] = []

        def one(state: dict[str, Tensor], share: list[Tensor]) -> list[Tensor]:
            weights = {f"member.{k}": v for k, v in state.items()}
            result = functional_call(call, weights, pytree.tree_unflatten(share, spec))
            flat, found = pytree.tree_flatten(result)
            form.append(found)
            return flat

        results = vmap(one, randomness="different")(self._state(), leaves)
        return pytree.tree_unflatten(results, form[-1])

    def members(self) -> list[Member]:
        """The single models, where the ensemble is, with the weights that they have now."""
        singles = []
        for index in range(len(self)):
            single = copy.deepcopy(self._template[0])
            single.load_state_dict({k: v[index].detach() for k, v in self._state().items()})
            singles.append(single.to(device_of(self)))
        return singles

    def loss(self, function: Callable[[Member, Any], Tensor]) -> Callable[[Any], Tensor]:
        """Sum of the members' losses.

        In training, a member that is lost (not finite) does not stop the rest. Where no gradient
        is recorded the loss is a score, and it is not finite if a member's is not.
        """

        def total(batch: Any) -> Tensor:
            each = self.map(function, batch)
            if not torch.is_grad_enabled():
                return each.sum()
            return torch.where(torch.isfinite(each), each, torch.zeros_like(each)).sum()

        return total

    def finite_members(self) -> Tensor:
        """Whether each member's gradient is finite, ``(members,)``."""
        finite = torch.ones(len(self), dtype=torch.bool)
        for weight in self.weights.values():
            if weight.grad is not None:
                finite &= torch.isfinite(weight.grad.flatten(1)).all(1).cpu()
        return finite

    def _state(self) -> dict[str, Tensor]:
        state: dict[str, Tensor] = {k.replace("/", "."): v for k, v in self.weights.items()}
        return state | {name: self.get_buffer(_mangled(name)) for name in self.buffer_names}


def _mangled(name: str) -> str:
    return name.replace(".", "/")


class _Call(nn.Module):
    """A function of a module as a module, which is what weights can be passed to."""

    def __init__(self, member: nn.Module, function: Callable[..., Any]) -> None:
        super().__init__()
        self.member, self.function = member, function

    def forward(self, *arguments: Any) -> Any:
        return self.function(self.member, *arguments)


def stack(trees: Sequence[Any]) -> Any:
    """Trees of tensors with equal shapes, stacked along a new first axis."""
    return pytree.tree_map(lambda *leaves: torch.stack(leaves), *trees)


class Stacked:
    """Training data of every member, indexed alike."""

    def __init__(self, data: Sequence[Any]) -> None:
        self.data = data

    def __len__(self) -> int:
        return min(len(d) for d in self.data)

    def __getitem__(self, index: Tensor | slice) -> Any:
        return stack([d[index] for d in self.data])
