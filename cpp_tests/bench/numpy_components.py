"""Three components in numpy: the closed form of src/reconstruct/components.rs on whole arrays, or (`solve`) the least-squares problem of every
vector, four equations for three unknowns, by its normal equations, as it is commonly written. Prints millions of vectors per second, elapsed and of the
processor's time: numpy_components.py [COUNT] [closed|solve]"""
import sys
import time
import numpy as np

N = int(sys.argv[1]) if len(sys.argv) > 1 else 4096
a = [np.sin((0.37 + 0.1 * k) * np.arange(1, N + 1)) for k in range(8)]


def components(s1x, s1y, s2x, s2y, d1x, d1y, d2x, d2y):
    ex, ey, gx, gy = s2x - s1x, s2y - s1y, d2x - d1x, d2y - d1y
    w = -(gx * ex + gy * ey) / (ex * ex + ey * ey)
    u = 0.5 * (d1x + d2x) + w * (0.5 * (s1x + s2x))
    v = 0.5 * (d1y + d2y) + w * (0.5 * (s1y + s2y))
    return u, v, w, np.sqrt(0.5 * ((gx + w * ex) ** 2 + (gy + w * ey) ** 2))


def solved(s1x, s1y, s2x, s2y, d1x, d1y, d2x, d2y):
    design, seen = np.zeros((N, 4, 3)), np.stack([d1x, d1y, d2x, d2y], axis=1)
    design[:, [0, 2], 0] = design[:, [1, 3], 1] = 1.0
    design[:, :, 2] = -np.stack([s1x, s1y, s2x, s2y], axis=1)
    turned = design.transpose(0, 2, 1)
    found = np.linalg.solve(turned @ design, turned @ seen[:, :, None])
    left = (design @ found)[:, :, 0] - seen
    return (*found[:, :, 0].T, np.sqrt((left**2).sum(axis=1)))


assert all(np.allclose(x, y) for x, y in zip(components(*a), solved(*a)))
way = solved if sys.argv[2:] == ["solve"] else components
way(*a)
begin, own, calls = time.perf_counter(), time.process_time(), 0
while time.perf_counter() - begin < 0.3:
    way(*a)
    calls += 1
done = 1e-6 * calls * N
print(done / (time.perf_counter() - begin), done / (time.process_time() - own))
