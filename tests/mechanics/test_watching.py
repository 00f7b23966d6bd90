"""spinestiff.mechanics.watching: long solves are told in lines, short ones are not."""

from __future__ import annotations

from spinestiff.mechanics.equilibrium import EquilibriumProblem, NewtonStep
from spinestiff.mechanics.watching import newton_line, watched
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import toy_torso


def newton_step(iteration, **changes):
    values = {"residual": 3.21e-4, "energy": -812.34567, "smallest_j": 0.4123, "step": 1.0, "projected": False}
    return NewtonStep(iteration, **({"factorised": True} | values | changes))


def test_a_newton_step_in_words():
    line = "iteration 7, residual 3.2e-04 N, energy -812.346 N mm, smallest J 0.412"
    assert newton_line(newton_step(7)) == line
    assert newton_line(newton_step(7, factorised=False)) == f"{line}, factor kept"
    assert newton_line(newton_step(7, factorised=False, step=0.0)) == line
    assert newton_line(newton_step(7, step=0.125, projected=True)) == (
        f"{line}, tangent not positive definite, step 0.12"
    )


def test_only_long_solves_say_something():
    said = []
    short = watched(said.append, "T8", every=60.0)
    for i in range(5):
        short(newton_step(i))
    assert said == []
    long = watched(said.append, "T8", every=0.0)
    for i in (0, 1, 2, 0, 1):
        long(newton_step(i))
    assert [line.split(",")[0] for line in said] == ["T8: iteration 1", "T8: iteration 2", "T8: iteration 1"]


def test_a_solve_can_be_watched():
    torso = toy_torso(1)
    said = []
    observe = watched(said.append, "push", every=0.0)
    found = EquilibriumProblem(torso, toy_supports(torso)).solve(toy_load(), observer=observe).require()
    assert len(said) == len(found.history) - 1 > 1
    assert f"residual {found.residual_norm:.1e} N" in said[-1]
    assert f"smallest J {found.smallest_j:.3g}" in said[-1]
