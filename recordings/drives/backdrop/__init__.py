"""Sky and ground of one picture on the undistorted canvas, linear light, RGB."""
