"""What a job will take, from its recipe: amounts, times, measuring stops."""
