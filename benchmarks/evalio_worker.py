"""One of evalio's pipelines on an exported drive: python evalio_worker.py PIPELINE DRIVE.npz OUT.npz."""

from __future__ import annotations

import sys
import time

import numpy as np
from evalio import pipelines  # of the rivals' environment
from evalio._cpp.helpers import DataType, Field, PointCloudMetadata, pc2_to_evalio
from evalio.types import SE3, ImuMeasurement, ImuParams, LidarParams, Stamp

_FIELDS = (("x", DataType.FLOAT32), ("y", DataType.FLOAT32), ("z", DataType.FLOAT32), ("t", DataType.UINT32),
           ("row", DataType.UINT16), ("col", DataType.UINT16))  # fmt: skip


def main() -> None:
    """Feed the drive in the order of its stamps; write poses of the IMU, their stamps, and the pipeline's own time."""
    name, drive, out = sys.argv[1:]
    data = np.load(drive)
    pipeline = getattr(pipelines, name)()
    rows, columns = data["shape"].tolist()
    g, rate = np.array([0.0, 0.0, -9.80665]), float(data["imu_rate"])
    noise = {"gyro": 2e-3, "accel": 3e-2, "gyro_bias": 1e-5, "accel_bias": 1e-4}
    pipeline.set_imu_params(ImuParams(**noise, gravity=g, rate=rate))
    pipeline.set_lidar_params(LidarParams(num_rows=rows, num_columns=columns, min_range=0.5, max_range=120.0))
    pipeline.set_imu_T_lidar(SE3.from_mat(np.asfortranarray(data["T_imu_lidar"])))
    pipeline.set_params(pipeline.default_params())
    pipeline.initialize()
    clouds, starts = data["clouds"], data["starts_ns"]
    fields = [Field(name=n, datatype=kind, offset=clouds.dtype.fields[n][1]) for n, kind in _FIELDS]
    step, taken, k = clouds.dtype.itemsize, 0.0, 0
    poses = []
    for i, start in enumerate(starts.tolist()):
        while k < len(data["imu_ns"]) and data["imu_ns"][k] <= start + 110_000_000:
            sample = ImuMeasurement(Stamp.from_nsec(int(data["imu_ns"][k])), data["gyro"][k], data["accel"][k])
            begin = time.process_time()
            pipeline.add_imu(sample)
            taken += time.process_time() - begin
            k += 1
        meta = PointCloudMetadata(stamp=Stamp.from_nsec(start), width=columns, height=rows, point_step=step,
                                  row_step=step * columns, is_bigendian=0, is_dense=1)  # fmt: skip
        scan = pc2_to_evalio(meta, fields, clouds[i].tobytes())
        begin = time.process_time()
        pipeline.add_lidar(scan)
        taken += time.process_time() - begin
        poses += pipeline.saved_estimates()
    stamps = np.array([stamp.to_nsec() for stamp, _ in poses], dtype=np.int64)
    np.savez(out, stamps_ns=stamps, T=np.array([T.to_mat() for _, T in poses]), seconds=taken, scans=len(starts))


if __name__ == "__main__":
    main()
