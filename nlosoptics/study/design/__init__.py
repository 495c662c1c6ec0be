"""Definition of a study: tables, base scene, design, figures of merit, and one point."""
