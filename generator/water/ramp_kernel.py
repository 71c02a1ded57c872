"""Light turned back in cells of a pixel's ray: adaptive quadrature of its density, compiled.

In every cell of gate time the density ρ is kept as its moments ρ_m = ∫ ρ P_m dτ over Legendre polynomials of the cell, so
that Σ_m (2m + 1) ρ_m ⟨R P_m⟩ is ∫ ρ R dτ up to the product of what the polynomials miss of ρ and of R. A cell is cut
where ρ is not smooth (the nearest path, the target, the edge of the beam and the ray's closest approach to its axis), and each
piece is halved until Gauss' 3-point rule agrees with Kronrod's 7-point rule, which contains it.
"""

from __future__ import annotations

import numpy as np

from ...optics.jit import kernel, prange
from ...optics.water.beam import halo_value

__all__ = ["KRONROD_NODE", "KRONROD_WEIGHT", "MOMENTS", "TOLERANCE", "ramp_of_pixels"]

#: Moments of the density kept in a cell, of the Legendre polynomials P₀ … P₃.
MOMENTS = 4
#: A piece is halved where the rules differ by more than this share of its light. That is the error of the 3-point rule; the
#: 7-point rule, whose value is kept, errs by far less.
TOLERANCE = 1e-3
#: A piece of a cell is not halved more often than this.
_MOST_HALVINGS = 16
#: Kronrod's 7-point rule on −1 … 1; its nodes 1, 3, 5 are those of Gauss' 3-point rule (weights 5/9, 8/9, 5/9).
KRONROD_NODE = np.array(
    [
        -0.9604912687080202, -0.7745966692414834, -0.4342437493468026, 0.0, 0.4342437493468026, 0.7745966692414834,
        0.9604912687080202,
    ]
)  # fmt: skip
KRONROD_WEIGHT = np.array(
    [
        0.1046562260264673, 0.2684880898683334, 0.4013974147759622, 0.4509165386584741, 0.4013974147759622,
        0.2684880898683334, 0.1046562260264673,
    ]
)  # fmt: skip


@kernel
def _density(  # type: ignore[no-untyped-def]
    path, direction, lamp, axis, base2, along, profile, edge, log_phase, turn0, inv_turn, forward, v0, inv_dv, inv_scale,
    inv_du, rate, shape, soft,
):  # fmt: skip
    """β̃ I/r₁² (with what was scattered forward) per metre of the path lamp-water-camera, without b and e^{−c·path}."""
    gap = path - along
    r2 = 0.5 * (path * path - base2) / gap
    r1 = path - r2
    bx = (r2 * direction[0] - lamp[0]) / r1
    by = (r2 * direction[1] - lamp[1]) / r1
    bz = (r2 * direction[2] - lamp[2]) / r1
    cx = axis[1] * bz - axis[2] * by
    cy = axis[2] * bx - axis[0] * bz
    cz = axis[0] * by - axis[1] * bx
    theta = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), axis[0] * bx + axis[1] * by + axis[2] * bz)
    light = 0.0
    if theta <= edge:
        x = theta * (profile.size - 1) / edge
        j = min(int(x), profile.size - 2)
        light = profile[j] + (x - j) * (profile[j + 1] - profile[j])
    veil = 0.0
    if forward:
        veil = halo_value(theta, 0.5 * path, v0, inv_dv, inv_scale, inv_du, rate, shape)
    if light + veil == 0.0:
        return 0.0
    sx = by * direction[2] - bz * direction[1]
    sy = bz * direction[0] - bx * direction[2]
    sz = bx * direction[1] - by * direction[0]
    back = -(bx * direction[0] + by * direction[1] + bz * direction[2])
    turn = np.arctan2(np.sqrt(sx * sx + sy * sy + sz * sz), back)
    x = min(max((np.log(max(turn, 1e-12)) - turn0) * inv_turn, 0.0), log_phase.size - 1.0)
    j = min(int(x), log_phase.size - 2)
    light *= np.exp(log_phase[j] + (x - j) * (log_phase[j + 1] - log_phase[j]))
    if veil > 0.0:
        x = min(turn / np.pi * (soft.shape[1] - 1.0), soft.shape[1] - 1.0)
        v = min(max((np.log(0.5 * path) - v0) * inv_dv, 0.0), soft.shape[0] - 1.0)
        j = min(int(x), soft.shape[1] - 2)
        m = min(int(v), soft.shape[0] - 2)
        low = soft[m, j] + (x - j) * (soft[m, j + 1] - soft[m, j])
        high = soft[m + 1, j] + (x - j) * (soft[m + 1, j + 1] - soft[m + 1, j])
        light += veil * np.exp(low + (v - m) * (high - low))
    slope = (path * gap - 0.5 * (path * path - base2)) / (gap * gap)
    return light / (r1 * r1) * slope


@kernel
def _cuts(direction, lamp, axis, base2, along, edge, nearest, end, cut):  # type: ignore[no-untyped-def]
    """Paths at which the density of a ray is not smooth, ascending, into `cut`; how many there are.

    On a cone about the beam's axis a·v = |v| cos(edge), v = r₂ d − s the way from the lamp: a quadratic in r₂. Nearest to
    the axis, in angle, the ray is at r₂ = [(s·d)(a·s) − (a·d) s²]/[(a·s) − (a·d)(s·d)].
    """
    cut[0], cut[1] = nearest, end
    count = 2
    if base2 > 0.0:
        ad = axis[0] * direction[0] + axis[1] * direction[1] + axis[2] * direction[2]
        a_s = axis[0] * lamp[0] + axis[1] * lamp[1] + axis[2] * lamp[2]
        cos2 = np.cos(edge) ** 2
        range_at = np.full(3, -1.0)
        second = ad * ad - cos2
        first = -2.0 * (ad * a_s - cos2 * along)
        zeroth = a_s * a_s - cos2 * base2
        root = first * first - 4.0 * second * zeroth
        if root >= 0.0:
            # the form without cancellation
            q = -0.5 * (first + np.sqrt(root)) if first >= 0.0 else -0.5 * (first - np.sqrt(root))
            if second != 0.0:
                range_at[0] = q / second
            if q != 0.0:
                range_at[1] = zeroth / q
        turn = a_s - ad * along
        if turn != 0.0:
            range_at[2] = (along * a_s - ad * base2) / turn
        for j in range(3):
            r2 = range_at[j]
            if r2 > 0.0 and r2 < 1e12:
                path = r2 + np.sqrt(max(r2 * r2 - 2.0 * r2 * along + base2, 0.0))
                if path > nearest and path < end:
                    cut[count] = path
                    count += 1
    for i in range(1, count):
        value = cut[i]
        j = i - 1
        while j >= 0 and cut[j] > value:
            cut[j + 1] = cut[j]
            j -= 1
        cut[j + 1] = value
    return count


@kernel(parallel=True)
def ramp_of_pixels(  # type: ignore[no-untyped-def]
    direction, lamp, axis, per_radiance, limit, offset, border, speed, weight, first, last, profile, edge, log_phase,
    turn0, inv_turn, b, c, nearest, forward, v0, inv_dv, inv_scale, inv_du, rate, shape, soft, node, share, moments,
    tolerance, out,
):  # fmt: skip
    """Photoelectrons (slice, pixel) of the medium's backscatter into `out`.

    Main arguments:
        direction (3, n), per_radiance (n), limit (n): unit rays, photoelectrons per radiance, ranges at which the rays end [m].
        offset (n): what light of the gate time τ arrives later by [s]; border (cells + 1): ends of the cells of gate time [s].
        weight (slice, cell·moments): (2m + 1) ⟨R P_m⟩ of the cells; first, last (slice): cells that a slice shows.
    """
    pixels = direction.shape[1]
    cells = border.size - 1
    base2 = lamp[0] ** 2 + lamp[1] ** 2 + lamp[2] ** 2
    block = 64
    for n in prange((pixels + block - 1) // block):
        density = np.empty(cells * moments)
        cut = np.empty(5)
        stack = np.empty((_MOST_HALVINGS + 2, 2))
        whole = np.empty(moments)
        rough = np.empty(moments)
        for p in range(n * block, min((n + 1) * block, pixels)):
            d = direction[:, p]
            along = lamp[0] * d[0] + lamp[1] * d[1] + lamp[2] * d[2]
            late = offset[p]
            r = limit[p]
            end = np.inf
            if r < np.inf:
                end = r + np.sqrt(max(r * r - 2.0 * r * along + base2, 0.0))
            count = _cuts(d, lamp, axis, base2, along, edge, nearest, end, cut)
            density[:] = 0.0
            for i in range(cells):
                begin = (border[i] + late) * speed
                finish = (border[i + 1] + late) * speed
                middle = 0.5 * (begin + finish)
                half = 0.5 * (finish - begin)
                for k in range(count - 1):
                    low = max(begin, cut[k])
                    high = min(finish, cut[k + 1])
                    if high <= low:
                        continue
                    top = 0
                    stack[0, 0], stack[0, 1] = low, high
                    while top >= 0:
                        x0, x1 = stack[top, 0], stack[top, 1]
                        top -= 1
                        centre = 0.5 * (x0 + x1)
                        width = 0.5 * (x1 - x0)
                        whole[:] = 0.0
                        rough[:] = 0.0
                        for j in range(7):
                            path = centre + width * node[j]
                            value = _density(
                                path, d, lamp, axis, base2, along, profile, edge, log_phase, turn0, inv_turn, forward,
                                v0, inv_dv, inv_scale, inv_du, rate, shape, soft,
                            )  # fmt: skip
                            value *= b * np.exp(-c * path) * width
                            x = (path - middle) / half
                            gauss = 0.0
                            if j == 3:
                                gauss = 8.0 / 9.0
                            elif j == 1 or j == 5:
                                gauss = 5.0 / 9.0
                            before, legendre = 0.0, 1.0
                            for m in range(moments):
                                whole[m] += share[j] * value * legendre
                                rough[m] += gauss * value * legendre
                                before, legendre = legendre, ((2 * m + 1) * x * legendre - m * before) / (m + 1)
                        # P₀ is the light of the piece; no moment is larger.
                        error = 0.0
                        for m in range(moments):
                            error = max(error, abs(whole[m] - rough[m]))
                        smooth = error <= tolerance * max(whole[0], density[i * moments])
                        if not (smooth or top > _MOST_HALVINGS - 2 or width < half * 0.5**_MOST_HALVINGS):
                            top += 1
                            stack[top, 0], stack[top, 1] = centre, x1
                            top += 1
                            stack[top, 0], stack[top, 1] = x0, centre
                            continue
                        for m in range(moments):
                            density[i * moments + m] += whole[m]
            for k in range(weight.shape[0]):
                total = 0.0
                for i in range(first[k] * moments, last[k] * moments):
                    total += weight[k, i] * density[i]
                # R's polynomials may undershoot by their own error where R is zero.
                out[k, p] = max(total, 0.0) * per_radiance[p]
