"""Reading recorded drives: MCAP records, message dialects, frames with their calibration and pose."""
