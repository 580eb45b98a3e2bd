"""Reports on flights: logs and monitor results to HTML, JSON, JUnit XML, figures and exports."""
