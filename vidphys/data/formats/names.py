"""What a column is by its name: a time, a place of some body, a rate, a known input, or nothing."""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import dataclass

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
LENGTHS |= {"in": 0.0254, "inch": 0.0254, "ft": 0.3048, "meter": 1.0, "meters": 1.0, "metres": 1.0}
PIXELS = frozenset({"px", "pixel", "pixels", "pix"})
SECONDS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3}
SECONDS |= {"msec": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0}
SECONDS |= {"d": 86400.0, "day": 86400.0, "days": 86400.0, "h": 3600.0, "hours": 3600.0}
RADIANS = {"rad": 1.0, "radian": 1.0, "radians": 1.0}
NO_LENGTHS = frozenset({"V", "mV", "A", "mA", "N", "kg", "J", "W", "Nm", "N·m", "Pa", "°C", "mT"})
DEGREES = ("deg", "degree", "degrees", "°", "grad", "gradi", "grados")
RADIANS |= dict.fromkeys(DEGREES, math.pi / 180)

DAYS = ("jd", "mjd", "jdtdb", "jdut", "julian date")  # dates as numbers, of astronomers
ROLES = {
    "time": {"t", "time", "times", "seconds", "sec", "timestamp", "timestamps", "zeit", "temps"}
    | {"tiempo", "tempo", "ms", "millis", "milliseconds", "elapsed", "elapsed time", "time stamp"}
    | {"datetime", "clock", "uhrzeit", "heure", "hora", "tid", "tijd", "czas", "aika", "ido"}
    | {"cas", "время", "zaman", *DAYS},
    "frame": {"frame", "frames", "frame number", "frame no", "index", "idx", "step", "bild"}
    | {"sample", "sample number", "frame idx", "frame index", "frame id", "frame num"}
    | {"coords", "slice", "slice n"},  # as DeepLabCut, ImageJ and its Manual Tracking call it
    "clip": {"clip", "episode", "trial", "run", "video", "sequence", "experiment", "versuch"},
    "body": {"body", "id", "track", "track id", "object", "particle", "label", "trackid"}
    | {"track n", "track no", "track number", "name"},
    "mass": {"mass", "m"},
    "coupling": {"coupling", "g", "strength"},
}
TELLS = dict.fromkeys(("ms", "millis", "milliseconds"), "ms")  # units that a time is called by
TELLS |= dict.fromkeys(DAYS, "d")
ANGLES = frozenset(
    {"theta", "angle", "phi", "psi", "o", "winkel", "ang", "joint", "angulo", "angolo"}
)
ALONE = {"q", "position", "pos", "displacement", "s", "distance", "d", "height", "h", "location"}
ALONE |= {"posicion", "posicao", "posizione", "posisjon", "hauteur", "hohe", "altura", "altezza"}
ALONE |= {"høyde", "abstand", "strecke", "strekning", "desplazamiento", "elongation", "auslenkung"}
ALONE |= {"altitude", "altitud", "depth"}
ALONE |= {"ort", "weg", "deflection", "extension", "coordinate", "spostamento", "deplacement"}
RATES = {"velocity", "vel", "speed", "acceleration", "accel", "acc", "omega", "w", "dot", "ddot"}
RATES |= {"v", "alpha", "rate", "momentum", "p", "geschwindigkeit", "beschleunigung", "vitesse"}
RATES |= {"velocidad", "velocidade", "velocita", "fart", "aceleracion", "aceleracao"}
RATES |= {"accelerazione", "akselerasjon"}
RATES |= {f"{d}{axis}" for d in ("v", "a", "d", "dd", "p") for axis in "xyzr"}
RATES |= {f"{d}{angle}" for d in ("d", "dd") for angle in ANGLES}
RATES |= {f"{axis}{dot}" for axis in ("x", "y", "z", "q", *ANGLES) for dot in ("dot", "ddot")}
INPUTS = {"torque", "tau", "force", "input", "u", "command", "cmd", "voltage", "current", "motor"}
INPUTS |= {"effort", "control", "drive", "moment", "kraft", "fuerza", "forca", "forza"}
INPUTS |= {"commanded", "setpoint"}
OTHERS = {"err", "error", "sigma", "std", "unc", "uncertainty", "likelihood", "confidence", "conf"}
OTHERS |= {"orientation", "quaternion", "quat"}
OTHERS |= {"score", "energy", "area", "radius", "temperature", "note", "width", "probability"}
MEASURES = {"length", "lengths", "lange", "lengde", "longueur", "longitud", "lunghezza", "lengte"}
MEASURES |= {"period", "periods", "periode", "periodo", "okres"}
FILLERS = {"pos", "position", "coord", "coordinate", "centroid", "center", "centre", "location"}
FILLERS |= {"image", "of", "the", "world", "axis"}
GREEK = {"θ": "theta", "φ": "phi", "ϕ": "phi", "ω": "omega", "α": "alpha", "ψ": "psi"}
GREEK |= {"τ": "tau", "ϑ": "theta", "σ": "sigma"}
CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
UNIT = re.compile(r"^(?P<name>.*?)\s*[\[({]\s*(?P<unit>[^\])}]*?)\s*[\])}]\s*$")
DERIVED = re.compile(r"der\s*\(.*\)|d\w+/dt")  # as Modelica and textbooks write a derivative
AFTER = re.compile(r"^(?P<name>.+?)\s*(?:/|\bin\b|,|_)\s*\(?(?P<unit>[^\s()]+)\)?$")


@dataclass(frozen=True)
class Meaning:
    """What a column's name says.

    Args:
        kind: a key of ``ROLES``, ``place``, ``rate``, ``input``, ``measure`` (of a thing, no place
            of a body: the length of a pendulum, its period) or empty.
        axis: of a place: x, y, z, u, v, angle or q (a coordinate alone).
        body: whom a place is of, or empty.
        unit: as it is written, or empty.
    """

    kind: str = ""
    axis: str = ""
    body: str = ""
    unit: str = ""


def meaning_of(name: str) -> Meaning:
    """Tell what a column is.

    Example:
        >>> meaning_of("ball_x (cm)")
        Meaning(kind='place', axis='x', body='ball', unit='cm')
        >>> meaning_of("v_{x}").kind, meaning_of("T [ms]").kind
        ('rate', 'time')
    """
    plain, unit = split_unit(name)
    if _dotted(plain) or DERIVED.fullmatch(plain) or _per_time(unit):
        return Meaning("rate", unit=unit)
    words = _words(plain)
    if not words:
        return Meaning("time", unit=unit) if unit in SECONDS else Meaning(unit=unit)
    joined = " ".join(word for word in words if not word.isdigit())
    for role, usual in ROLES.items():
        if joined in usual:
            unit = unit or TELLS.get(joined, "")
            return Meaning(role, unit=unit)
    spoken = [word for word in words if not word.isdigit()]
    labels = [word for word in words if word.isdigit()]
    if not spoken:
        return Meaning(unit=unit)
    if any(word in OTHERS for word in spoken):
        return Meaning(unit=unit)
    if any(word in MEASURES for word in spoken):
        return Meaning("measure", unit=unit)
    if len(spoken) == 1 and spoken[0] in ("u", "v"):
        return Meaning("place", spoken[0], "".join(labels), unit)
    axis = next((word for word in spoken if word in "xyz" or word in ANGLES), "")
    place = spoken.index(axis) if axis else 0
    if any(w in RATES for w in spoken) or (spoken[0] == "a" and place == 1):
        return Meaning("rate", unit=unit)
    if any(word in INPUTS for word in spoken):
        return Meaning("input", unit=unit)
    if not axis and any(word in ALONE for word in spoken):
        alone = next(word for word in spoken if word in ALONE)
        spoken.remove(alone)
        kind = "angle" if unit in RADIANS else "q"
        return Meaning("place", kind, " ".join([*spoken, *labels]), unit)
    if not axis:
        return Meaning(unit=unit)
    rest = [word for word in words if word != axis and word not in FILLERS]
    return Meaning("place", "angle" if axis in ANGLES else axis, " ".join(rest), unit)


def split_unit(name: str) -> tuple[str, str]:
    """A name and the unit that is written behind it: ``x [cm]``, ``x (cm)``, ``x/cm``, ``x_cm``."""
    text = _straight(name)
    found = UNIT.match(text)
    if found and (_known(found["unit"]) or _per_time(found["unit"])):
        return found["name"].rstrip(" _/"), _unit(found["unit"])
    found = AFTER.match(text)
    if found and "_{" not in text and (_known(found["unit"]) or _per_time(found["unit"])):
        return found["name"], _unit(found["unit"])
    found = UNIT.match(text)
    if found and found["unit"] in NO_LENGTHS:
        return found["name"], found["unit"]
    return text, ""


def is_unit(cell: str) -> bool:
    """Whether a cell of a line below the names says a unit, or nothing."""
    bare = _straight(cell).strip("[](){} ")
    bracketed = bool(re.fullmatch(r"\s*[\[({].*[\])}]\s*", cell))
    return bracketed or bare in ("", "1", "-", "kg", "N") or _known(bare) or _per_time(bare)


def _straight(name: str) -> str:
    return unicodedata.normalize("NFKC", name.strip().strip('"')).replace("μ", "µ")


def _unit(text: str) -> str:
    return text if text in ("m", "M") else text.lower()


def _known(unit: str) -> bool:
    lower = unit.lower()
    return any(lower in table for table in (LENGTHS, PIXELS, SECONDS, RADIANS))


def _per_time(unit: str) -> bool:
    return bool(re.search(r"/\s*\(?\s*m?s|s\s*\^?\s*[-−]\s*[12]|s⁻|hz", unit.lower()))


def _dotted(name: str) -> bool:
    """Whether a letter carries the dot of a derivative, or a prime follows it."""
    marks = unicodedata.normalize("NFD", name)
    return (
        "\u0307" in marks
        or "\u0308" in marks
        and name[:1] in "ẍÿẌŸ"
        or bool(re.search("['’′]", name))
    )


def _words(name: str) -> list[str]:
    text = "".join(f" {GREEK[c]} " if c in GREEK else c for c in name)
    text = CAMEL.sub(" ", text.replace("{", "").replace("}", "").replace("_", " "))
    text = text.lower().replace("\\", " ")
    text = re.sub(r"^([vad]) (?=[xyz]\b)", r"\1", text.strip())
    text = re.sub(r"\b(?:pos|c|t)([xyz])(?=\b|\d)", r"pos \1", text)
    text = re.sub("[\u0300-\u036f]", "", unicodedata.normalize("NFD", text))  # accents
    return re.findall(r"[^\W\d_]+|\d+", text)
