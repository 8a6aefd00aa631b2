"""Verification of mixing backends: problems with known answers, and studies of convergence.

    from scaleup.verification import fitted_order, problems, run

    problem = problems()["vortex"]
    results = [run(problem, backend, n) for n in problem.sizes]
    fitted_order(results)

`backend` is any instance of a `scaleup.contract.Mixing`. Importing this package starts MPI.
"""

from scaleup.verification.problem import Problem
from scaleup.verification.problems import problems
from scaleup.verification.study import Result, fitted_order, run

__all__ = ["Problem", "Result", "fitted_order", "problems", "run"]
