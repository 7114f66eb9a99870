//! Simulated plants and scenarios for tesaki.
