//! The address of a host that is given by its name.

use anyhow::{Context as _, Result};
use std::net::{SocketAddr, ToSocketAddrs as _};

pub fn resolve(remote: &str) -> Result<SocketAddr> {
    let found = remote.to_socket_addrs().with_context(|| format!("there is no host for {remote}"))?;
    let all: Vec<SocketAddr> = found.collect();
    // Ground stations listen on IPv4.
    all.iter()
        .find(|address| address.is_ipv4())
        .or(all.first())
        .copied()
        .with_context(|| format!("no address for {remote}"))
}
