"""What a model is compared with: rows with a prediction, their noise, and those held out."""
