"""The signs of a result for other programs: spreadsheets, geographic information systems, log viewers."""
