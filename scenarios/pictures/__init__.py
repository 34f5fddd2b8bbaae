"""Pictures of a run, made from its recording alone: video, contact sheet, plot."""
