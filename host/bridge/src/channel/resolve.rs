//! Host names to addresses. A look-up can take seconds, so each runs in its own thread and not in
//! the loop.

use anyhow::{Context as _, Result};
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;

/// Resolves a host name; blocks.
pub fn resolve(remote: &str) -> Result<SocketAddr> {
    let found =
        remote.to_socket_addrs().with_context(|| format!("there is no host for {remote}"))?;
    let all: Vec<SocketAddr> = found.collect();
    // Ground stations listen on IPv4, so its addresses come first.
    all.iter()
        .find(|address| address.is_ipv4())
        .or(all.first())
        .copied()
        .with_context(|| format!("no address for {remote}"))
}

/// A look-up in progress.
pub struct LookUp(Receiver<Result<SocketAddr>>);

impl LookUp {
    pub fn begin(remote: String) -> LookUp {
        let (sender, receiver) = mpsc::channel();
        // The caller may have dropped the receiver.
        thread::spawn(move || drop(sender.send(resolve(&remote))));
        LookUp(receiver)
    }

    /// The result, once the look-up has ended.
    pub fn result(&self) -> Option<Result<SocketAddr>> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(anyhow::anyhow!("the look-up has ended"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn a_look_up_returns_at_once_and_has_its_result_later() {
        let look_up = LookUp::begin(String::from("127.0.0.1:14550"));
        let start = Instant::now();
        let result = loop {
            if let Some(result) = look_up.result() {
                break result;
            }
            assert!(start.elapsed() < Duration::from_secs(60));
            thread::yield_now();
        };
        assert_eq!(result.unwrap(), "127.0.0.1:14550".parse().unwrap());
    }
}
