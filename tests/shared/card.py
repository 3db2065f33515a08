"""A card that is none: tensors that say ``cuda`` and refuse what a card refuses, on any machine.

What is computed is right, because each tensor on the card stands for one on the CPU, where its
operations are run. What a card would break by surprise breaks here too: an operation over tensors
of two devices (but for numbers without axes, and indices), ``.numpy()`` of a tensor that is not on
the CPU, a generator of the other device, numbers that compiled loops of the CPU read by address,
what comes to the CPU without being waited for.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from dynamics.pairs import pair_indices
from dynamics.triples import triple_indices

CARD = torch.device("cuda", 0)
CPU = torch.device("cpu")
aten = torch.ops.aten
INDEXED = (aten.index.Tensor, aten.index_put.default, aten.index_put_.default)  # indices: any
INDEXED += (aten._unsafe_index.Tensor, aten._index_put_impl_.default)
ACROSS = (aten._to_copy.default, aten.copy_.default)
WRONG = -1e9  # what there is in memory that nobody wrote to yet
ON_THE_WAY: list[tuple[Tensor, Tensor]] = []  # to the CPU: where to, and what
BETWEEN: list[str] = []  # operations between the card and the CPU while the card was to record
GET_DEVICE = Tensor.device.__get__


class OnCard(Tensor):
    """A tensor on the card; ``held`` is what it stands for."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> OnCard:
        # Its own device is meta, as that of torch's fake tensors: the system has no other for it.
        return Tensor._make_wrapper_subclass(
            cls, held.size(), strides=held.stride(), storage_offset=held.storage_offset(),
            dtype=held.dtype, device="meta",
        )  # fmt: skip

    def __init__(self, held: Tensor) -> None:
        self.held = held

    def __repr__(self) -> str:
        return f"OnCard({self.held!r})"

    @property
    def device(self) -> torch.device:
        return CARD

    @property
    def is_cuda(self) -> bool:
        return True

    @property
    def is_cpu(self) -> bool:
        return False

    @property
    def is_meta(self) -> bool:
        return False

    def numpy(self, *, force: bool = False) -> Any:
        raise TypeError("can't convert cuda:0 device type tensor to numpy; use .cpu() first")

    def __array__(self, *_: Any) -> Any:
        return self.numpy()

    def __deepcopy__(self, memo: dict[int, Any]) -> Tensor:
        copy = self.detach().clone().requires_grad_(self.requires_grad)
        if isinstance(self, torch.nn.Parameter):
            copy = torch.nn.Parameter(copy, self.requires_grad)
        memo[id(self)] = copy
        return copy

    def tolist(self) -> Any:
        return self.detach().held.tolist()

    def record_stream(self, _: Any) -> None:
        """Nothing here gives memory away too early."""

    def pin_memory(self, *_: Any) -> Tensor:
        raise RuntimeError("cannot pin 'torch.cuda.FloatTensor': only dense CPU tensors can be")

    @classmethod
    def __torch_dispatch__(
        cls, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        return run(function, args, kwargs or {})


def leaves(given: Any) -> Iterator[Any]:
    """What lies in tuples, lists and dictionaries; torch's own way is slow."""
    if isinstance(given, (tuple, list)):
        for each in given:
            yield from leaves(each)
    elif isinstance(given, dict):
        for each in given.values():
            yield from leaves(each)
    else:
        yield given


def mapped(kind: type, change: Callable[[Any], Any], given: Any) -> Any:
    """The same with what is of a kind changed."""
    if isinstance(given, kind):
        return change(given)
    if isinstance(given, (tuple, list)):
        return type(given)([mapped(kind, change, each) for each in given])
    if isinstance(given, dict):
        return {key: mapped(kind, change, each) for key, each in given.items()}
    return given


def run(function: Any, args: Any, kwargs: Any) -> Any:
    """An operation where its tensors are."""
    flat = [x for x in leaves((args, kwargs)) if isinstance(x, Tensor)]
    if Graph.recording and _crosses(function, args, kwargs):
        BETWEEN.append(str(function))
    on_card = [x for x in flat if isinstance(x, OnCard)]
    asked = kwargs.get("device")
    if function in ACROSS or (function is aten.copy_.default):
        pass
    elif on_card:
        loose = args[1:2] if function in INDEXED else ()
        free = {id(x) for x in leaves(loose)}
        for x in flat:
            if not isinstance(x, OnCard) and x.dim() and id(x) not in free:
                raise RuntimeError(
                    f"{function}: expected all tensors to be on the same device, but found at "
                    f"least two devices, cuda:0 and cpu (of shape {tuple(x.shape)})"
                )
        for x in flat:
            if isinstance(x, OnCard) and id(x) in free and not isinstance(args[0], OnCard):
                raise RuntimeError(f"{function}: indices should be on the CPU or the tensor's own")
    result_on_card = bool(on_card)
    if asked is not None:
        asked = torch.device(asked)
        result_on_card = asked.type != "cpu"
        kwargs = {**kwargs, "device": CPU}
    elif function is aten.copy_.default:
        result_on_card = isinstance(args[0], OnCard)
    generator = kwargs.get("generator")
    if generator is not None and result_on_card != isinstance(generator, CardGenerator):
        raise RuntimeError(
            f"{function}: expected a '{'cuda' if result_on_card else 'cpu'}' device type for "
            "generator but found the other"
        )
    if function in (aten._local_scalar_dense.default, aten.equal.default):
        result_on_card = False
    if function is aten._efficientzerotensor.default:  # of no memory, which nothing can stand for
        function = aten.zeros.default
    held = mapped(OnCard, lambda x: x.held, (args, kwargs))
    if Graph.recording:
        Graph.recording.look(held)
    found = function(*held[0], **held[1])
    if Graph.recording and result_on_card:
        Graph.recording.operations.append((function, *held, found))
    known = {id(x.held): x for x in on_card}

    def wrapped(x: Tensor) -> Tensor:
        if not result_on_card:
            return x.clone() if function is aten._to_copy.default else x
        return known.get(id(x)) if id(x) in known else OnCard(x)

    return mapped(Tensor, wrapped, found)


class CardGenerator(torch.Generator):
    """A generator of the card."""


class _Dispatch(TorchDispatchMode):
    """Operations that are given no tensor of the card, and may make one."""

    def __torch_dispatch__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        return run(function, args, kwargs or {})


class _Event:
    """That what the card was asked for till now is done, which nobody knows who does not wait."""

    def __init__(self, enable_timing: bool = False) -> None:
        self.asked = 0

    def record(self) -> None:
        self.asked = len(ON_THE_WAY)

    def synchronize(self) -> None:
        for number, (here, there) in enumerate(ON_THE_WAY[: self.asked]):
            ON_THE_WAY[number] = here.copy_(there), there

    def elapsed_time(self, _: Any) -> float:
        return 1.0


class Graph:
    """Operations of the card, recorded to be run again on the memory that they were recorded on."""

    recording: Graph | None = None

    def __init__(self) -> None:
        self.operations: list[tuple[Any, Any, Any, Any]] = []
        self.before: dict[int, tuple[Tensor, Tensor]] = {}

    def look(self, given: Any) -> None:
        """Remember what lies in memory that is written to, maybe: a recording changes nothing."""
        for x in leaves(given):
            if isinstance(x, Tensor) and id(x) not in self.before:
                self.before[id(x)] = x, x.clone()

    def replay(self) -> None:
        for function, args, kwargs, found in self.operations:
            again = function(*args, **kwargs)
            for old, new in zip(leaves(found), leaves(again), strict=True):
                if isinstance(old, Tensor) and old is not new and old.data_ptr() != new.data_ptr():
                    old.copy_(new)


@contextlib.contextmanager
def _record(graph: Graph) -> Iterator[None]:
    """What is between the card and the CPU is in ``BETWEEN``, and refused as a card does."""
    Graph.recording = graph
    try:
        yield
    finally:
        Graph.recording = None
        for x, old in graph.before.values():
            if not torch.equal(x, old):  # one that was written to has memory of its own
                x.copy_(old)
    if BETWEEN:
        raise RuntimeError("operation not permitted when stream is capturing")


def _crosses(function: Any, args: Any, kwargs: Any) -> bool:
    """Whether an operation waits for the card, or takes there what lies in the CPU's memory."""
    if function in (aten._local_scalar_dense.default, aten.equal.default, aten.nonzero.default):
        return True
    if function not in ACROSS:
        return False
    source = args[1] if function is aten.copy_.default else args[0]
    to = args[0].device if function is aten.copy_.default else kwargs.get("device")
    moves = to is not None and (torch.device(to).type == "cpu") == isinstance(source, OnCard)
    return moves and isinstance(source, Tensor)


class _Names(TorchFunctionMode):
    """What is asked of ``cuda`` is asked of ``meta``, the device that tensors on the card have."""

    def __torch_function__(
        self, function: Callable[..., Any], types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        if function is GET_DEVICE:
            found = function(*args, **kwargs)
            return CARD if found.type == "meta" else found

        def renamed(x: Any) -> Any:
            if isinstance(x, torch.device) and x.type == "cuda":
                return torch.device("meta")
            return x

        name = getattr(function, "__name__", "")
        if name == "cuda":
            return args[0].to(torch.device("meta"))
        if name == "__getitem__":  # torch puts a list on the tensor's own device, which is meta
            args = args[0], mapped(list, torch.tensor, args[1])
        if name == "cpu" and args:
            return args[0].to(CPU)
        kwargs = {key: value for key, value in kwargs.items() if key != "pin_memory"}
        if name == "pin_memory":
            return args[0].clone()
        if name == "copy_" and kwargs.get("non_blocking") and isinstance(args[1], OnCard):
            ON_THE_WAY.append((args[0].fill_(WRONG), args[1].held.clone()))
            return args[0]
        if kwargs.get("device") is not None:
            kwargs = {**kwargs, "device": renamed(torch.device(kwargs["device"]))}
        if name in ("tensor", "as_tensor") and (kwargs.get("device") or CPU).type == "meta":
            return function(*args, **{**kwargs, "device": CPU}).to(torch.device("meta"))
        if name == "new_tensor" and isinstance(args[0], Tensor) and args[0].device == CARD:
            kwargs = {"dtype": args[0].dtype, **kwargs, "device": CPU}
            return torch.tensor(*args[1:], **kwargs).to(torch.device("meta"))
        if name == "to" and len(args) > 1 and isinstance(args[1], str):
            args = (args[0], torch.device(args[1]), *args[2:])
        args = tuple(renamed(x) for x in args)
        return function(*args, **kwargs)


def _nothing(*_: Any) -> None:
    """In place of what asks a real card whether it is recording a graph."""


def _inference(mode: bool = True) -> contextlib.AbstractContextManager[Any]:
    return torch.no_grad() if mode else contextlib.nullcontext()


@contextlib.contextmanager
def a_card() -> Iterator[None]:
    """Inside, this machine has one card.

    Example:
        >>> with a_card():
        ...     x = torch.ones(2, device="cuda")
        ...     (x + 1).cpu().tolist(), x.device.type
        ([2.0, 2.0], 'cuda')
    """
    with (
        mock.patch("torch.cuda.is_available", lambda: True),
        mock.patch("torch.cuda.get_device_name", lambda *_: "a card that is none"),
        mock.patch("dynamics.compiled.head.has_triton", lambda: False),
        mock.patch("renderers.reused.has_triton", lambda: False),
        mock.patch("dynamics.engines.has_triton", lambda: False),
        mock.patch("torch.cuda.synchronize", lambda *_: None),
        # a weight of another precision is a new one, not an old one that stands for something else
        mock.patch("torch.__future__.get_overwrite_module_params_on_conversion", lambda: True),
        mock.patch("torch.cuda.current_stream", mock.MagicMock()),
        mock.patch("torch.cuda.Stream", mock.MagicMock()),
        mock.patch("torch.cuda.stream", lambda _: contextlib.nullcontext()),
        mock.patch("torch.cuda.Event", _Event),
        mock.patch("torch.cuda.CUDAGraph", Graph),
        mock.patch("torch.cuda.graph", _record),
        mock.patch("torch.optim.Optimizer._accelerator_graph_capture_health_check", _nothing),
        # Tensors of inference mode cannot stand for others; what it allows, no_grad allows.
        mock.patch("torch.inference_mode", _inference),
        _Names(),
        _Dispatch(),
    ):
        try:
            yield
        finally:
            ON_THE_WAY.clear()
            BETWEEN.clear()
            for kept in (pair_indices, triple_indices):  # under the card's name
                kept.cache_clear()
