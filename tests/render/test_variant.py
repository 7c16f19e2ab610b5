"""Which of Mitsuba's variants stay when Lambent asks for a device."""

import pytest

from lambent.render.variant import _stays, mitsuba


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
    mi = mitsuba()
    before = mi.variant()
    try:
        mi.set_variant("llvm_ad_spectral")
        assert mitsuba("auto").variant() == "llvm_ad_spectral"
        assert mitsuba("cpu").variant() == "llvm_ad_spectral"
    finally:
        mi.set_variant(before)
