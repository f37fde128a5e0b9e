"""From readings to evidence: channels by place, screened, and digested for fit and diagnosis."""
