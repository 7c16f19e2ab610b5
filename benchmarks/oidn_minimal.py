"""The minimal script: read an EXR, denoise with OIDN High, write the result.

The yardstick for the cold start of `lambent denoise`: what a person would write with the same
libraries, without waste. The colour's three channels are read as R G B, `albedo.*` and `normal.*`
as guides; all other channels are written back as they were read.

Usage: python benchmarks/oidn_minimal.py IN.exr OUT.exr
"""

import sys

import mitsuba_oidn
import numpy as np
import OpenEXR


def main(source: str, target: str) -> None:
    with OpenEXR.File(source, separate_channels=True) as file:
        header, channels = file.header(), file.channels()

        def image(names: list[str]) -> np.ndarray | None:
            if not all(name in channels for name in names):
                return None
            planes = [channels[name].pixels for name in names]
            stack = np.empty((*planes[0].shape, 3), np.float32)
            for i, plane in enumerate(planes):
                stack[:, :, i] = plane
            return stack

        clean = mitsuba_oidn.denoise(
            image(["R", "G", "B"]),
            image(["albedo.R", "albedo.G", "albedo.B"]),
            image(["normal.X", "normal.Y", "normal.Z"]),
            hdr=True,
            quality=mitsuba_oidn.Quality.High,
        )
        result = {name: channel.pixels for name, channel in channels.items()}
        for i, name in enumerate("RGB"):
            result[name] = np.ascontiguousarray(clean[:, :, i], dtype=result[name].dtype)
        with OpenEXR.File(header, result) as out:
            out.write(target)


if __name__ == "__main__":
    main(*sys.argv[1:3])
