"""Tangent blocks of corotational tets, and their sum.

With g = R grad phi in the room's axes and the stiffness M against turning there, a pair of
vertices a, b has the block

    lam g_a g_b^T + mu g_b g_a^T + mu g_a . g_b I + [g_a]x M [g_b]x^T,

integrated over the tet. Since [a]x [b]x^T = a . b I - b a^T, that is

    lam g_a g_b^T + 2 mu g_b g_a^T + [g_a]x (M + mu I) [g_b]x^T.
"""

import numpy as np
from scipy.sparse import csr_array

from plantsim.arrays import Array
from plantsim.elastic.pattern import Pattern

# tets at a time: at order 1 some ten arrays of nine rows then stay in the second cache
PART = 1024


def one_point(g: Array, M: Array, w: Array, mu: Array, lam: Array) -> Array:
    """Return the blocks of pairs a <= b at order 1, (m, 10, 3, 3) [N/m].

    All arguments with tets last: g (3, 3, m) of the last three vertices (those of all four
    sum to zero), M (3, 3, m); w, mu, lam (m,).
    """
    m = len(w)
    a_lam, a_mu = g * (w * lam), g * (2 * w * mu)
    M = M * w
    for i in range(3):
        M[i, i] += w * mu
    K = np.empty((4, 4, 3, 3, m))
    C = np.empty((3, 3, m))
    work = np.empty((3, m))
    wide = np.empty((3, 3, m))
    for b in range(3):
        p = g[b]
        for k in range(3):  # C = M [g_b]x^T, column by column
            r, s = (k + 1) % 3, (k + 2) % 3
            np.multiply(M[:, s], p[r], out=C[:, k])
            np.multiply(M[:, r], p[s], out=work)
            C[:, k] -= work
        for a in range(b + 1):
            B, o = K[a + 1, b + 1], g[a]
            np.multiply(a_lam[a][:, None], p[None], out=B)
            np.multiply(p[:, None], a_mu[a][None], out=wide)
            B += wide
            for i in range(3):  # [g_a]x C, row by row
                r, s = (i + 1) % 3, (i + 2) % 3
                np.multiply(C[s], o[r], out=work)
                B[i] += work
                np.multiply(C[r], o[s], out=work)
                B[i] -= work
            if a < b:
                K[b + 1, a + 1] = B.swapaxes(0, 1)
    # a rigid shift asks no force
    np.add(K[1, 1:], K[2, 1:], out=K[0, 1:])
    K[0, 1:] += K[3, 1:]
    K[0, 0] = K[0, 1] + K[0, 2]
    K[0, 0] += K[0, 3]
    np.negative(K[0, 1:], out=K[0, 1:])
    out = np.empty((m, 10, 3, 3))
    for p, (a, b) in enumerate(zip(*np.triu_indices(4), strict=True)):
        out[:, p] = K[a, b].transpose(2, 0, 1)
    return out


def many_points(
    D: Array, w: Array, R: Array, M: Array, products: Array, moduli: tuple[Array, Array]
) -> Array:
    """Return the blocks of pairs a <= b of any order, (m, p, 3, 3) [N/m].

    D (m, c, 3q) gradients, w (m, q), R and M in rest axes (m q, 3, 3); `products` (m, p)
    integrals of grad phi_a . grad phi_b; mu and lam (m,).
    """
    mu, lam = moduli
    m, c = D.shape[:2]
    q = w.shape[1]
    grad = D.reshape(m, c, q, 3).transpose(0, 2, 3, 1).reshape(m * q, 3, c)
    g = (R @ grad).transpose(0, 2, 1).reshape(m, q, 3 * c)
    outer = (g * w[:, :, None]).transpose(0, 2, 1) @ g
    cross = np.zeros((m * q, c, 3, 3))  # [grad phi_a]x, rows k, columns n
    for n in range(3):
        r, s = (n + 1) % 3, (n + 2) % 3
        cross[:, :, r, n] = grad[:, s]
        cross[:, :, s, n] = -grad[:, r]
    # R^T on the left of every vertex's block, as one product: (c n, k) @ (k, i)
    Y = cross.transpose(0, 1, 3, 2).reshape(-1, 3 * c, 3) @ R.transpose(0, 2, 1)
    Y = Y.reshape(m, q, c, 3, 3).transpose(0, 2, 4, 1, 3).reshape(m, 3 * c, 3 * q)
    wM = (M * w.reshape(-1, 1, 1)).reshape(m, q, 3, 3)
    YM = (Y.reshape(m, 3 * c, q, 1, 3) @ wM[:, None]).reshape(m, 3 * c, 3 * q)
    turning = YM @ Y.transpose(0, 2, 1)
    one, other = np.triu_indices(c)
    O = outer.reshape(m, c, 3, c, 3)[:, one, :, other].swapaxes(0, 1)  # noqa: E741
    K = turning.reshape(m, c, 3, c, 3)[:, one, :, other].swapaxes(0, 1)
    K += lam[:, None, None, None] * O
    K += mu[:, None, None, None] * O.swapaxes(2, 3)
    shear = mu[:, None] * products
    for i in range(3):
        K[:, :, i, i] += shear
    return K


def summed(pattern: Pattern, pairs: Array) -> csr_array:
    """Return the matrix (3n, 3n) of blocks (m p, 9) of pairs, in the order of the tets."""
    straight, swapped = pattern.halves
    both = np.empty((len(pattern.start) - 1, 2, 3, 3))
    K = (straight @ pairs).reshape(-1, 3, 3)
    K += (swapped @ pairs).reshape(-1, 3, 3).swapaxes(1, 2)
    both[:, 0] = K
    both[:, 1] = K.swapaxes(1, 2)
    return pattern.matrix(both)
