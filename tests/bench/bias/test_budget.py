import math
from dataclasses import replace

import numpy as np
import pytest
from GTC import component, dof, get_covariance, reporting, uncertainty, ureal

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.budget import SOURCES, BudgetedDwell, BudgetInputs, bias_budgets, coverage_factor
from gyrobench.bench.bias.error_split import ErrorPart, total_covariance
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, RADPS_TO_DPH
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.dwell_rows import dwell_row
from tests.bench.bias.emulated_dwells import emulate, noise_model, sensors, site

NOISE = noise_model(0.0006)
