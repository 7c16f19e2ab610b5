"""Which of Mitsuba's variants stay when Lambent asks for a device."""

import subprocess
import sys
import textwrap

import pytest

from lambent.render.variant import _stays


@pytest.mark.parametrize(
    ("variant", "device", "backend", "stays"),
    [
        ("cuda_ad_rgb", "auto", "llvm", True),  # chosen by --device cuda, or by a script
        ("llvm_ad_rgb", "auto", "cuda", True),
        ("llvm_mono", "auto", "llvm", True),
        ("llvm_mono", "cpu", "llvm", True),
        ("cuda_ad_rgb", "cpu", "llvm", False),
        ("llvm_ad_rgb", "cuda", "cuda", False),
        ("scalar_rgb", "auto", "llvm", False),
        (None, "auto", "llvm", False),
    ],
)
def test_a_variant_that_was_chosen_stays(variant, device, backend, stays):
    assert _stays(variant, device, backend) is stays


def test_a_script_keeps_its_own_variant():
    script = """
        from lambent.render.variant import mitsuba
        mi = mitsuba()
        assert mi.variant() == "llvm_ad_rgb", mi.variant()
        mi.set_variant("llvm_ad_spectral")
        for device in ("auto", "cpu"):
            assert mitsuba(device).variant() == "llvm_ad_spectral", device
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
