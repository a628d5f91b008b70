# SPDX-License-Identifier: GPL-3.0-or-later
"""The self-test that a GPU must pass, on warp's CPU device, and with kernels that err."""

import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.machine.backend import warp_on_cpu
from irgspp.core.machine.devices import ChosenDevice
from irgspp.core.rendering import trusted_device as module
from irgspp.core.rendering.trusted_device import gpu_fault, trusted_device

CPU, GPU = torch.device("cpu"), torch.device("cuda", 0)


@pytest.fixture(autouse=True)
def forgotten():
    gpu_fault.cache_clear()
    yield
    gpu_fault.cache_clear()


@pytest.mark.parametrize("warp", [False, True], ids=["numba", "warp"])
def test_right_kernels_pass(warp):
    if warp:
        pytest.importorskip("warp")
    with warp_on_cpu(warp):
        assert gpu_fault(CPU) is None


def test_wrong_results_are_named(monkeypatch):
    right = module.trace
    monkeypatch.setattr(module, "trace", lambda *values: 1.02 * right(*values))
    assert gpu_fault(CPU) == "results of the ray tracer differ by 2.0%"


def test_a_wrong_gradient_is_named(monkeypatch):
    right = module.photometric_loss
    monkeypatch.setattr(module, "photometric_loss", lambda a, b: right(a.detach(), b) + 0 * a.sum())
    assert "photometric loss" in str(gpu_fault(CPU))


def test_values_that_are_not_finite_fail(monkeypatch):
    right = module.rasterize
    monkeypatch.setattr(module, "rasterize", lambda *values: (right(*values)[0] * float("nan"), None))
    assert "rasteriser" in str(gpu_fault(CPU))


def test_an_error_of_the_gpu_fails(monkeypatch):
    def broken(*values):
        raise RuntimeError("CUDA error: no kernel image is available for execution on the device\nmore")

    monkeypatch.setattr(module, "rasterize", broken)
    assert "no kernel image" in str(gpu_fault(CPU))


def test_a_gpu_that_fails_is_left_and_one_that_passes_is_taken(monkeypatch):
    said = []
    monkeypatch.setattr(module, "choose_device", lambda name: ChosenDevice(GPU, "a suitable GPU was found", True, 1))
    monkeypatch.setattr(module, "gpu_fault", lambda device: "results of the ray tracer differ by 40%")
    chosen = trusted_device("auto", said.append)
    assert chosen.device == CPU and not chosen.warp and "differ by 40%" in chosen.why and len(said) == 1
    assert trusted_device("cuda").device == GPU  # as the user insists
    monkeypatch.setattr(module, "gpu_fault", lambda device: None)
    assert trusted_device("auto").device == GPU


def test_the_cpu_is_not_tested(monkeypatch):
    monkeypatch.setattr(module, "gpu_fault", lambda device: pytest.fail("tested"))
    assert trusted_device("cpu").device == CPU
    if not torch.cuda.is_available():
        assert trusted_device("auto").device == CPU
        with pytest.raises(InputError):
            trusted_device("cuda")
