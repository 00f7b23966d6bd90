"""Make radiographs' corners from known stiffness ratios, and get the ratios back by a fit.

The fit uses the mesh that made the data, and no noise: it shows how the pieces go together, not how well they work. It
allows for errors that these corners do not have, and so ends beside the truth, well inside its interval.

Run: python examples/02_recover_ratios.py
"""

import numpy as np

import spinestiff as ss

truth = {"lateral_bending": 0.1, "tissue": 0.01}
torso = ss.template_torso(height_cm=157, mesh="coarse")
problem = ss.EquilibriumProblem(torso, ss.three_point_supports(torso, side="right"))
view = ss.frontal_view(centre=torso.rest_pose.bone_positions[torso.bone("T12")])


def trial(force_n: float) -> ss.Trial:
    """What a frontal radiograph shows of the true torso under a push from the right."""
    load = ss.rib_push(torso, side="right", level=8, force_n=force_n)
    pushed = problem.solve(load, ss.stiffness_ratios(truth)).require()
    corners = ss.state_features(torso, view, pushed.state).corners
    return ss.Trial(load, ss.VertebraCorners(torso.vertebrae, corners), view, label=f"{force_n:.0f} N", push="right")


fit = ss.fit_stiffness(problem, [trial(20.0), trial(40.0)])
print(fit)

found = fit.ratios.as_dict()
for name, value in truth.items():
    print(f"{name}: true {value:g}, found {found[name]:.6g}")
correlation = float(fit.correlation[0, 1])
print(f"correlation {correlation:+.2f}: a stiffer spine makes up for softer tissue")
assert np.isfinite(correlation)
