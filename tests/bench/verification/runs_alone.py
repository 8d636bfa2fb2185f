"""Results of one run, compared with no other."""

from gyrobench.bench.verification.coefficient_verification import CoefficientRun, compare_coefficients
from gyrobench.bench.verification.compensation_verification import MeasuredRun, compare_runs
from gyrobench.bench.verification.paired_plateaus import pair_dwells
from gyrobench.bench.verification.run_residuals import check_plateau


def compensation_result(compensation, dwells, check_dwells, site, fitted_c, model=None):
    run = MeasuredRun(compensation, tuple(dwells), tuple(check_dwells), model)
    [result] = compare_runs([run], site, fitted_c)
    return result


def coefficient_result(compensation, rows, correlations, site):
    [result] = compare_coefficients([CoefficientRun(compensation, rows, correlations)], site)
    return result


def check_residuals(rows, check_dwells, site):
    return [
        check_plateau(plateau, {each.dwell for each in plateau}, site, "none", 1)
        for [plateau] in pair_dwells([[*rows, *check_dwells]])
    ]
