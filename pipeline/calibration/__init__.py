"""`wayside calibrate`: a camera from images of a chessboard, or from a drive."""
