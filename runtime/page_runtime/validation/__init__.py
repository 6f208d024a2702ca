"""Estimates of many recordings against their truth: compared, spread over processes, summed up."""
