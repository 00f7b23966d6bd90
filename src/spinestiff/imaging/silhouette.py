"""Where the outline of a vertebral body has its corner: between two box corners, where the rim is seen farthest out.

A box has two corners behind one another in the beam, an endplate has a round rim. Midway between the two corners lies
m, half a height up and half a width aside, h is half their difference and r the ray to m, all in the vertebra's axes.
The rim, an ellipse, is (m up) + (m aside) cos a + h sin a. In the picture h looks, to first order, like
v = h - (h_d / r_d) r, which has no depth d; so the rim reaches out, in half widths and half heights together, by

    cos a + g sin a + const.,    g = sum over k of v_k / m_k,

most for tan a = g. The corner is taken at that depth, the full half width aside where walls and endplate meet:
m + t h with t = sin a = g / sqrt(1 + g^2). It lies midway (t = 0) where the endplate is seen edge on, nearer to one of
the two box corners (t = 1 or -1) the more of it is seen. The paper (4.1) takes the box corner itself, which lies beside
the bone and shifts by |h| times the angle where a patient turns; the outline's corner shifts by |t h| times it.
"""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats


def halves(pairs: Floats) -> tuple[Floats, Floats]:
    """Of pairs (..., 2, n): the middle of the two, and half of first less second, (..., n) each."""
    first, second = np.moveaxis(pairs, -2, 0)
    return 0.5 * (first + second), 0.5 * (first - second)


def rim_share(middle: Floats, half: Floats, ray: Floats, depth: int) -> Floats:
    """(...) t between -1 and 1 of ``m + t h``, where the rim reaches out furthest as it is seen.

    Parameters
    ----------
    middle, half : (..., 3) mm, m and h; m is not 0 but along ``depth``.
    ray : (..., 3) mm from the source to m.
    depth : axis of the vertebra that lies along the beam: 0 in a lateral, 2 in a frontal view. The box's sides lie
        along the axes.
    """
    reach = _reach(middle, half, ray, depth)
    return np.asarray(reach / np.sqrt(1.0 + reach**2))


def rim_share_slope(
    middle: Floats, half: Floats, ray: Floats, depth: int, slopes: tuple[Floats, Floats, Floats]
) -> Floats:
    """(..., n) derivative of ``rim_share`` in n unknowns, of which m, h and r have the ``slopes`` (..., 3, n)."""
    d_middle, d_half, d_ray = slopes
    others = [axis for axis in range(3) if axis != depth]
    along, far = half[..., depth, None], ray[..., depth, None]
    total = np.zeros(d_ray.shape[:-2] + d_ray.shape[-1:])
    for k in others:
        m, r = middle[..., k, None], ray[..., k, None]
        v = half[..., k, None] - along * r / far
        d_v = (
            d_half[..., k, :]
            - (d_half[..., depth, :] * r + along * d_ray[..., k, :]) / far
            + along * r / far**2 * d_ray[..., depth, :]
        )
        total += d_v / m - v / m**2 * d_middle[..., k, :]
    reach = _reach(middle, half, ray, depth)
    return np.asarray(total / (1.0 + reach[..., None] ** 2) ** 1.5)


def _reach(middle: Floats, half: Floats, ray: Floats, depth: int) -> Floats:
    """(...) g: how far h, as it is seen, reaches outwards, in half widths and half heights."""
    seen = half - (half[..., depth] / ray[..., depth])[..., None] * ray
    others = [axis for axis in range(3) if axis != depth]
    return np.asarray(np.sum(seen[..., others] / middle[..., others], axis=-1))
