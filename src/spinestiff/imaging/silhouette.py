"""Where the outline of a vertebral body has its corner: on the round rim of an endplate, between two box corners.

A box has two corners behind one another in the beam, a body has a round rim. With m midway between the two (half a
width aside, half a height up), h the half difference and r the ray to m, all in the vertebra's axes, the rim is
m cos a + h sin a across the body. Moving by h looks like moving by v = h - (h_d / r_d) r, which has no depth d, so
that the rim reaches out, in half widths and half heights together, by

    cos a + g sin a + const.,    g = sum over k of v_k / m_k,

most for tan a = g. The corner is taken at m + t h with t = sin a = g / sqrt(1 + g^2): halfway (t = 0) where the
endplate is seen edge on, nearer to one of the two box corners (t = 1 or -1) the more of it is seen. The paper (4.1)
takes the box corner itself, which lies beside the bone: it shifts where a patient turns, and no outline does.
"""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats


def rim_share(middle: Floats, half: Floats, ray: Floats, depth: int) -> Floats:
    """(...) t between -1 and 1 of ``m + t h``, where the rim reaches out furthest as it is seen.

    Parameters
    ----------
    middle, half : (..., 3) mm, m and h; m is not 0 but along ``depth``.
    ray : (..., 3) mm from the source to m.
    depth : axis of the vertebra that lies along the beam: 0 in a lateral, 2 in a frontal view.
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
