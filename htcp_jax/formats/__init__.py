"""Files from outside, read into plain arrays and mappings: tables, scans, XML, YAML. Knows nothing of robots."""
