"""Taking the exposures: metering, planning, shooting, summing, writing the results."""
