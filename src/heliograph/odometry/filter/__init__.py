"""The tightly coupled iterated error-state Kalman filter on raw points."""
