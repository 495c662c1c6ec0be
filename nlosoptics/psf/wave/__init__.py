"""The sampled wave in the exit pupil: its nodes, series, slopes and sampling regime."""
