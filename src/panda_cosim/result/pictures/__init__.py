"""Pictures of a run, made from its recording: video, contact sheet, plot."""
