"""What `import vidphys` and the stages offer: every name is there, and nothing heavy with it."""

import importlib
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import dynamics
import vidphys

PACKAGES = (
    "registry",
    "loops",
    "dynamics",
    "dynamics.compiled",
    "renderers",
    "encoders",
    "encoders.frozen",
    "binders",
    "readouts",
    "viz",
    "vidphys",
)
HEAVY = ("torch", "numpy", "pyarrow", "scipy")


def loaded_after(statement):
    code = f"import sys; {statement}; print(*sys.modules)"
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_has_every_name_that_it_offers(package):
    module = importlib.import_module(package)
    assert len(set(module.__all__)) == len(module.__all__) > 0
    assert set(dir(module)) >= set(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    home = Path(module.__file__).parent
    assert "." in package or (home / "py.typed").is_file()


def test_names_are_loaded_when_touched():
    assert not set(HEAVY) & set(loaded_after("import vidphys, viz, registry, loops"))
    assert "torch" in loaded_after("import vidphys; vidphys.build")


def test_a_model_as_data_needs_no_torch_and_what_rolls_it_comes_with_what_makes_it_fast():
    assert not {"torch", "dynamics.head"} & set(
        loaded_after("from dynamics import terms; terms.to_config(terms.HEADS['gns'])")
    )
    for name in set(dynamics.__all__) - {"terms", "HEADS", "from_config", "to_config"}:
        assert dynamics.HOMES[name] != "dynamics.terms"
    assert "dynamics.engines" in loaded_after("from dynamics import PhaseState")
    assert "dynamics.engines" in loaded_after("import readouts")


def test_frozen_encoders_do_not_load_their_libraries():
    assert not {"transformers", "timm"} & set(
        loaded_after("import encoders; encoders.load_encoder")
    )


def test_the_version_is_the_distribution_s():
    assert vidphys.__version__ == version("vidphys")


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="module 'vidphys' has no attribute 'gravitation'"):
        _ = vidphys.gravitation
