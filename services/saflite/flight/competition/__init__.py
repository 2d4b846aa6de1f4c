"""The UAV testing competition's test-case documents, as Aerialist reads them."""
