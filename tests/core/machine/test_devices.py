# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of a job's device, whatever machine the tests run on: the detected CUDA is made up."""

import json
from dataclasses import replace

import pytest
import torch
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.machine import cuda
from irgspp.core.machine.backend import by_warp
from irgspp.core.machine.cuda import CudaInfo, DeviceLost, cuda_obstacle, translate_gpu_errors
from irgspp.core.machine.devices import WARP_ON_CPU, choose_device, computing_on
from irgspp.core.machine.gpu_memory import FEWEST, RAYS, estimate_gpu_memory, plan, rays_that_fit
from irgspp.core.pipeline import DEMO_DATA, reconstruct
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import trainer as trainers
from irgspp.core.stages.first.trainer import Trainer

GIB = 1 << 30
GOOD = CudaInfo((13, 0), "13.0", True, True, (9, 0), 20 * GIB)
OBSTACLES = {
    "no driver": (replace(GOOD, driver=None), "no NVIDIA driver"),
    "old driver": (replace(GOOD, driver=(12, 4)), "580 or newer"),
    "torch for the CPU": (replace(GOOD, torch_cuda=None, torch_sees=False), "CPU alone"),
    "no card": (replace(GOOD, torch_sees=False, capability=None), "no GPU"),
    "old card": (replace(GOOD, capability=(7, 0)), "7.5"),
    "no warp": (replace(GOOD, warp=False), "irgspp[cuda]"),
}


def test_a_suitable_gpu_is_chosen():
    for name in ("auto", "cuda"):
        chosen = choose_device(name, lambda: GOOD)
        assert chosen.device == torch.device("cuda", 0) and chosen.warp and chosen.free == 20 * GIB
    assert cuda_obstacle(GOOD) is None and cuda_obstacle(replace(GOOD, driver=(13, 2), capability=(7, 5))) is None


@pytest.mark.parametrize(("found", "words"), OBSTACLES.values(), ids=OBSTACLES)
def test_an_obstacle_is_reported_in_one_line_and_auto_takes_the_cpu(found, words):
    with pytest.raises(InputError, match=words.replace("[", r"\[")) as caught:
        choose_device("cuda", lambda: found)
    assert "\n" not in str(caught.value) and "--device cuda" in str(caught.value)
    chosen = choose_device("auto", lambda: found)
    assert chosen.device.type == "cpu" and not chosen.warp and "cuda can't be used" in chosen.why


def test_cpu_is_taken_without_a_look_at_the_gpu():
    assert choose_device("cpu", lambda: pytest.fail("looked")).device.type == "cpu"


def test_warp_works_on_the_cpu_where_a_test_asks_for_it():
    tensor = torch.zeros(1)
    with computing_on(choose_device(WARP_ON_CPU)):
        assert by_warp(tensor)
    assert not by_warp(tensor)
    with computing_on(choose_device("cpu")):
        assert not by_warp(tensor)


def test_probing_this_machine_does_not_fail():
    found = cuda.probe_cuda()
    assert found.torch_sees == torch.cuda.is_available()


@pytest.mark.parametrize("text", ["CUDA error: an illegal memory access was encountered\nCUDA kernel errors might be ...",
                                  "Warp CUDA error 719: unspecified launch failure", "CUDA driver error: device lost"])  # fmt: skip
def test_a_failed_gpu_is_reported_in_one_line(text):
    with pytest.raises(DeviceLost) as caught, translate_gpu_errors(resumable=True):
        raise RuntimeError(text)
    assert "\n" not in str(caught.value) and "--resume" in str(caught.value) and caught.value.exit_status == 1


@pytest.mark.parametrize("error", [torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nmore"),
                                   RuntimeError("Failed to allocate 1024 bytes on device 'cuda:0'")])  # fmt: skip
def test_exhausted_gpu_memory_is_reported_in_one_line(error):
    with pytest.raises(IrgsppError, match=r"memory ran out.*--resume") as caught, translate_gpu_errors(resumable=True):
        raise error
    assert "\n" not in str(caught.value)


def test_other_errors_stay_what_they_are():
    with pytest.raises(RuntimeError, match="shape") as caught, translate_gpu_errors():
        raise RuntimeError("shape mismatch")
    assert not isinstance(caught.value, IrgsppError)
    with pytest.raises(InputError), translate_gpu_errors():
        raise InputError("here", "is wrong")


def test_a_job_fits_by_keeping_less_on_the_gpu():
    settings = preset("paper")
    views = (settings, 200, 800, 800)
    roomy = plan(*views, 80 * GIB)
    assert roomy.targets
    moved = plan(*views, int(0.9 * roomy.needed))
    assert not moved.targets and roomy.needed - moved.needed > 200 * 800 * 800 * 40


def test_fewer_rays_are_at_work_where_memory_is_short():
    gpu = torch.device("cuda", 0)
    numbers = [rays_that_fit(gpu, lambda device, free=free: free) for free in (80 * GIB, GIB, GIB // 4, 0)]
    assert numbers[0] == RAYS > numbers[1] > numbers[2] > numbers[3] == FEWEST
    assert rays_that_fit(torch.device("cpu")) == RAYS


def test_a_job_that_cannot_fit_is_refused_before_it_starts():
    with pytest.raises(InputError, match=r"GiB .*, of which 2\.0 GiB are free") as caught:
        plan(preset("paper"), 200, 800, 800, 2 * GIB)
    assert "\n" not in str(caught.value) and "data.resolution" in str(caught.value)


def test_more_of_anything_takes_more_memory():
    settings = preset("paper")
    base = estimate_gpu_memory(settings, 100, 800, 800, True)
    assert estimate_gpu_memory(settings, 101, 800, 800, True) > base
    assert estimate_gpu_memory(settings, 100, 900, 800, True) > base
    more = replace(settings, first=replace(settings.first, gaussians=10_000_000))
    assert estimate_gpu_memory(more, 100, 800, 800, True) > base


def test_a_lost_gpu_leaves_a_checkpoint(tmp_path, monkeypatch):
    done = Trainer.step

    def fails(trainer):
        if trainer.done == 12:
            raise RuntimeError("CUDA error: unspecified launch failure\nCompile with ...")
        return done(trainer)

    monkeypatch.setattr(trainers, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(Trainer, "step", fails)
    small = ["materials=low-gloss", "first.gaussians=500", "first.iterations=30", "first.stereo=off", "first.open_edges=0", "device=cpu"]
    with pytest.raises(DeviceLost, match="--resume"):
        reconstruct(DEMO_DATA, tmp_path / "run", with_overrides(preset("draft"), small))
    state = torch.load(tmp_path / "run" / "checkpoint" / "first_stage.pt", weights_only=True)
    assert int(state["done"]) == 12
    assert "GPU failed" in json.loads((tmp_path / "run" / "run.json").read_text())["error"]
