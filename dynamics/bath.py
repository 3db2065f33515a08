"""Heat baths as ports: friction and the noise that belongs to it, both stepped exactly.

A bath is the Ornstein-Uhlenbeck process dp = -(friction - drive) p dt + sqrt(2 m noise T) dW, with
rates per second and k_B = 1. Fluctuation and dissipation are tied by noise = friction (Kubo,
Rep. Prog. Phys. 29, 255 (1966)), and one step of any length has the exact mean and variance
(Gillespie, Phys. Rev. E 54, 2084 (1996)). The mobility may depend on the parameters, never on the
state.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.findings import Finding, NoSteadyState, counted
from dynamics.numbers import unbent
from dynamics.ports import Port
from dynamics.state import Parameters, PhaseState


class Bath(Port):
    """A port whose step is a Gaussian: :meth:`kick` draws from it, :meth:`nll` is its density."""

    def nll(
        self,
        before: Float[Tensor, "*b n d"],
        after: Float[Tensor, "*b n d"],
        params: Parameters,
        dt: float,
    ) -> Float[Tensor, "*b"]:
        """Negative log density of momenta ``dt`` seconds later, up to a constant, ``(...)``.

        Args:
            before, after: momenta, ``(..., n, d)``.
            params: with a temperature > 0.
            dt: seconds.
        """
        raise NotImplementedError

    def check(self, params: Parameters) -> None:
        """Refuse noise that no real covariance has (the study's Prop. on passive friction).

        Raises:
            ValueError: friction < 0 and temperature > 0 in some episode.
        """
        friction, temperature = params.scalars.get("friction"), params.scalar("temperature")
        if bool((temperature < 0).any()):
            raise ValueError(f"{type(self).__name__}: temperature must be >= 0")
        if friction is not None and bool(((friction < 0) & (temperature > 0)).any()):
            raise ValueError(
                f"{type(self).__name__}: friction < 0 with temperature > 0 has no real noise "
                "covariance 2 T M; ask about negative friction at temperature 0"
            )


class DiagonalBath(Bath):
    """A bath that acts on each coordinate by itself; subclasses say how strongly.

    All rates broadcast to ``(..., n, d)`` and are per second.
    """

    def friction(self, params: Parameters) -> Tensor:
        """What takes energy."""
        raise NotImplementedError

    def drive(self, params: Parameters) -> Tensor:
        """What gives energy against the friction."""
        return torch.zeros((), dtype=params.mass.dtype, device=params.mass.device)

    def noise(self, params: Parameters) -> Tensor:
        """Strength of the fluctuations; that of the friction, by fluctuation-dissipation."""
        return self.friction(params)

    def net(self, params: Parameters) -> Tensor:
        """Friction less drive: the rate at which momentum decays."""
        return self.friction(params) - self.drive(params)

    def moments(self, params: Parameters, dt: float) -> tuple[Tensor, Tensor]:
        """(decay, variance): after ``dt`` seconds p is normal around decay * p."""
        net = self.net(params)
        amount = params.mass.unsqueeze(-1) * _spread(params.scalar("temperature"))
        return torch.exp(-net * dt), amount * self.noise(params) * _accumulated(net, dt)

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        decay, variance = self.moments(params, dt)
        return decay * state.p + variance.sqrt() * torch.randn_like(state.p)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return -self.net(params) * state.p

    def nll(
        self,
        before: Float[Tensor, "*b n d"],
        after: Float[Tensor, "*b n d"],
        params: Parameters,
        dt: float,
    ) -> Float[Tensor, "*b"]:
        decay, variance = self.moments(params, dt)
        error = (after - decay * before).square() / variance
        return 0.5 * (error + variance.log()).sum((-2, -1))

    def concerns(self, params: Parameters) -> list[Finding]:
        with torch.no_grad():
            net = self.net(params)
            noise = self.noise(params) * _spread(params.scalar("temperature"))
            lost = ((net < 0) | ((net == 0) & (noise > 0))).flatten(-2).any(-1)
            lost = lost.expand(params.coupling.shape)
        if not bool(lost.any()):
            return []
        text = (
            f"{type(self).__name__}: no steady state in {counted(lost)}: the drive is at least "
            "the friction, so that the energy grows for ever"
        )
        return [Finding(NoSteadyState, text, lost, term=type(self).__name__)]


class ExactBath(DiagonalBath):
    """The true bath: friction, and drive where there is one, as the parameters say.

    Example:
        >>> from dynamics.state import PhaseState
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> law = law.with_scalar("friction", 2.0).with_scalar("temperature", 0.0)
        >>> moving = PhaseState(torch.zeros(1, 1, 2), torch.ones(1, 1, 2))
        >>> [round(x, 3) for x in ExactBath().kick(moving, law, dt=0.5).flatten().tolist()]  # e^-1
        [0.368, 0.368]
    """

    def friction(self, params: Parameters) -> Tensor:
        return _spread(params.scalar("friction"))

    def drive(self, params: Parameters) -> Tensor:
        return (
            _spread(params.scalars["drive"]) if "drive" in params.scalars else super().drive(params)
        )


class PassiveBath(DiagonalBath):
    """Diagonal friction that is positive whatever the told friction.

    friction = softplus(a + b gamma) for each coordinate: it can fit any positive friction, and can
    give energy at none.
    """

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__()
        self.dissipation = Positive(bodies, space)

    def friction(self, params: Parameters) -> Tensor:
        return self.dissipation(params.scalar("friction"))


class UntiedBath(PassiveBath):
    """The same without fluctuation-dissipation: the noise is learned apart from the friction."""

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__(bodies, space)
        self.fluctuation = Positive(bodies, space)

    def noise(self, params: Parameters) -> Tensor:
        return self.fluctuation(params.scalar("friction"))


class FactoredBath(DiagonalBath):
    """Friction gamma M_0 with M_0 > 0 learned: it gives energy at gamma < 0."""

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.zeros(bodies, space))

    def friction(self, params: Parameters) -> Tensor:
        return _spread(params.scalar("friction")) * nn.functional.softplus(self.raw)


class ConstantBath(DiagonalBath):
    """One learned friction gamma_f > 0; the drive is not an input (the control).

    Args:
        bodies, space: of the states.
        rate: where the friction starts, per second.
    """

    def __init__(self, bodies: int, space: int, rate: float | None = None) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.zeros(1, 1))
        if rate is not None:
            self.set(rate)

    def set(self, rate: float) -> None:
        """Let the friction be this, per second."""
        with torch.no_grad():
            self.raw.fill_(unbent(rate))

    def friction(self, params: Parameters) -> Tensor:
        return nn.functional.softplus(self.raw)


class DrivenBath(ConstantBath):
    """Net damping gamma_f - A w, noise tied to gamma_f; gamma_f, w > 0 learned."""

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__(bodies, space)
        self.raw_drive = nn.Parameter(torch.zeros(1, 1))

    def drive(self, params: Parameters) -> Tensor:
        return _spread(params.scalar("drive")) * nn.functional.softplus(self.raw_drive)


class FullBath(Bath):
    """Friction operator g(gamma) L L^T of all coordinates at once, with correlated noise.

    L is lower triangular and acts on p / sqrt(m); g is positive. One step is exact through the
    matrix exponential.
    """

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__()
        size = bodies * space
        self.strength = Positive(1, 1)
        self.raw = nn.Parameter(torch.eye(size) + 0.1 * torch.randn(size, size))

    @property
    def operator(self) -> Tensor:
        """L L^T, symmetric and positive semidefinite by construction, ``(n d, n d)``."""
        lower = torch.tril(self.raw)
        return lower @ lower.mT

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        root = params.mass.sqrt().unsqueeze(-1)
        rates, axes = torch.linalg.eigh(self.operator)
        # Rounding may leave a rate of zero just below it.
        exponent = self._strength(params) * rates.clamp_min(0) * dt
        along = (state.p / root).flatten(-2) @ axes
        temperature = params.scalar("temperature").unsqueeze(-1)
        size = (-temperature * torch.expm1(-2 * exponent)).sqrt()
        after = torch.exp(-exponent) * along + size * torch.randn_like(along)
        return root * (after @ axes.mT).reshape(state.p.shape)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        root = params.mass.sqrt().unsqueeze(-1)
        slowed = (state.p / root).flatten(-2) @ self.operator
        return -root * (self._strength(params) * slowed).reshape(state.p.shape)

    def nll(
        self,
        before: Float[Tensor, "*b n d"],
        after: Float[Tensor, "*b n d"],
        params: Parameters,
        dt: float,
    ) -> Float[Tensor, "*b"]:
        root = params.mass.sqrt().unsqueeze(-1)
        # Not through eigenvectors: their gradient is lost where two rates are equal.
        exponent = self._strength(params).unsqueeze(-1) * self.operator * dt
        decay = torch.linalg.matrix_exp(-exponent)
        unit = torch.eye(len(self.operator), dtype=decay.dtype, device=decay.device)
        covariance = (1 + ROUNDING) * unit - decay @ decay
        lower = torch.linalg.cholesky(covariance)
        start, end = ((p / root).flatten(-2).unsqueeze(-1) for p in (before, after))
        error = torch.linalg.solve_triangular(lower, end - decay @ start, upper=False)
        temperature = params.scalar("temperature")
        spread = (
            lower.diagonal(dim1=-2, dim2=-1).log().sum(-1) + 0.5 * len(unit) * temperature.log()
        )
        return 0.5 * error.square().sum((-2, -1)) / temperature + spread

    def _strength(self, params: Parameters) -> Tensor:
        return self.strength(params.scalar("friction")).squeeze(-1)


class Positive(nn.Module):
    """softplus(a + b x) of one strength x, for each of ``bodies`` times ``space`` coordinates."""

    def __init__(self, bodies: int, space: int) -> None:
        super().__init__()
        self.offset = nn.Parameter(torch.zeros(bodies, space))
        self.slope = nn.Parameter(torch.zeros(bodies, space))

    def forward(self, x: Tensor) -> Tensor:
        """``(...) -> (..., bodies, space)``."""
        return nn.functional.softplus(self.offset + self.slope * _spread(x))


ROUNDING = 1e-6  # of float32: keeps a covariance of next to no friction positive definite


def _spread(x: Tensor) -> Tensor:
    """An episode's strength ``(...)`` over its coordinates, ``(..., 1, 1)``."""
    return x[..., None, None]


def _accumulated(rate: Tensor, dt: float) -> Tensor:
    """Integral of 2 exp(-2 rate s) over ``dt`` seconds, for rates of either sign and none."""
    none = rate == 0
    safe = torch.where(none, torch.ones_like(rate), rate)
    return torch.where(none, 2 * dt * torch.ones_like(rate), -torch.expm1(-2 * safe * dt) / safe)


def relaxation_time(params: Parameters) -> Float[Tensor, "*b"]:
    """1 / (friction - drive), seconds in which a driven bath forgets its start, ``(...)``.

    A temperature that is measured over less than about twenty of them says little; infinite where
    there is no steady state.
    """
    friction = params.scalar("friction")
    net = friction - params.scalars.get("drive", torch.zeros_like(friction))
    return torch.where(net > 0, 1 / net, torch.inf)


def steady_temperature(params: Parameters) -> Float[Tensor, "*b"]:
    """T friction / (friction - drive), the temperature of the steady state, ``(...)``.

    Raises:
        ValueError: there is no steady state, because drive >= friction somewhere.

    Example:
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1)).with_scalar('friction', 2.0)
        >>> law = law.with_scalar('drive', 1.0).with_scalar('temperature', 0.5)
        >>> steady_temperature(law).tolist(), relaxation_time(law).tolist()
        ([1.0], [1.0])
    """
    friction, drive = params.scalar("friction"), params.scalar("drive")
    if bool((drive >= friction).any()):
        raise ValueError(
            "steady_temperature: no steady state: the drive is at least the friction "
            f"(largest drive - friction: {float((drive - friction).max()):g} per second)"
        )
    return params.scalar("temperature") * friction / (friction - drive)
