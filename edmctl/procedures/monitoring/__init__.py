"""What is watched for a whole run: telemetry, drift, the line, the sensor against the model."""
