"""Sky and ground of one image on the undistorted canvas, linear light, RGB."""
