"""The laboratory's procedures, on the emulated bench with the laboratory's chamber."""

import pytest

pytestmark = pytest.mark.emulated_bench(station="stations/laboratory.yaml")


@pytest.mark.worlds("ideal", "gyro_a")
def test_both_positions_are_measured_without_flags(run_procedure):
    run = run_procedure("procedures/two_positions.yaml", fail_on="flagged")
    assert list(run.dwells["position"]) == ["z_up", "z_down"]


@pytest.mark.emulated_bench(world="ideal", seed=1)
def test_the_bias_of_the_world_is_found(run_procedure):
    run = run_procedure("procedures/two_positions.yaml")
    assert run.dwells["bias_z_dph"].mean() == pytest.approx(0.004, abs=0.02)
