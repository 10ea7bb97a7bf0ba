"""Files and folders of files: clouds, tables, trajectories, KITTI."""
