//! The user's notation for channels.

use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

/// A channel as the user writes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Spec {
    UdpOut(String),
    UdpIn(SocketAddr),
    TcpOut(String),
    TcpIn(SocketAddr),
    Serial { path: PathBuf, baud: u32 },
}

/// Minimum baud rate: a slower line cannot carry one status of a node a second.
const BAUD_MIN: u32 = 300;

const EXAMPLES: &str = "write for example udpout:127.0.0.1:14550, udpin:14550, tcp:HOST:5760, \
                        tcpin:5760 or serial:/dev/ttyUSB0:57600";

impl FromStr for Spec {
    type Err = String;

    fn from_str(text: &str) -> Result<Spec, String> {
        let (kind, rest) =
            text.split_once(':').filter(|(_, rest)| !rest.is_empty()).ok_or(EXAMPLES)?;
        let remote = || match rest.rsplit_once(':') {
            Some((host, port))
                if !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port != 0) =>
            {
                Ok(rest.to_owned())
            }
            _ => Err(format!("\"{rest}\" is not HOST:PORT; {EXAMPLES}")),
        };
        // Without an address: the loopback interface.
        let local = || match rest.parse::<u16>() {
            Ok(port) => Ok(SocketAddr::from((Ipv4Addr::LOCALHOST, port))),
            Err(_) => rest
                .parse::<SocketAddr>()
                .map_err(|_| format!("\"{rest}\" is not PORT or ADDRESS:PORT; {EXAMPLES}")),
        };
        Ok(match kind {
            "udpout" => Spec::UdpOut(remote()?),
            "udpin" => Spec::UdpIn(local()?),
            "tcp" | "tcpout" => Spec::TcpOut(remote()?),
            "tcpin" => Spec::TcpIn(local()?),
            "serial" => {
                let (path, baud) = match rest.rsplit_once(':') {
                    Some((path, baud)) => match baud.parse() {
                        Ok(rate) if rate >= BAUD_MIN => (path, rate),
                        _ => {
                            return Err(format!(
                                "\"{baud}\" is not a baud rate: {BAUD_MIN} or more"
                            ));
                        }
                    },
                    None => (rest, 57_600),
                };
                Spec::Serial { path: path.into(), baud }
            }
            other => return Err(format!("unknown kind of channel \"{other}\"; {EXAMPLES}")),
        })
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Spec::UdpOut(remote) => write!(f, "udpout:{remote}"),
            Spec::UdpIn(local) => write!(f, "udpin:{local}"),
            Spec::TcpOut(remote) => write!(f, "tcp:{remote}"),
            Spec::TcpIn(local) => write!(f, "tcpin:{local}"),
            Spec::Serial { path, baud } => write!(f, "serial:{}:{baud}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_have_the_syntax_of_the_help() {
        let udp_in = |address: &str| Ok(Spec::UdpIn(address.parse().unwrap()));
        assert_eq!("udpout:10.0.0.1:14550".parse(), Ok(Spec::UdpOut("10.0.0.1:14550".into())));
        assert_eq!("udpin:14550".parse(), udp_in("127.0.0.1:14550"));
        assert_eq!("udpin:0.0.0.0:14550".parse(), udp_in("0.0.0.0:14550"));
        assert_eq!("tcp:host:5760".parse(), Ok(Spec::TcpOut("host:5760".into())));
        assert_eq!("tcpin:5760".parse(), Ok(Spec::TcpIn("127.0.0.1:5760".parse().unwrap())));
        let serial = |baud| Ok(Spec::Serial { path: "/dev/ttyUSB0".into(), baud });
        assert_eq!("serial:/dev/ttyUSB0".parse(), serial(57_600));
        assert_eq!("serial:/dev/ttyUSB0:115200".parse(), serial(115_200));
        let wrong = "udpin udpin: udpout:14550 udpout::1 udpout:h:0 udpin:70000 x:1 tcp:h: \
            serial:/dev/x:0";
        for wrong in wrong.split(' ').chain([""]) {
            assert!(wrong.parse::<Spec>().is_err(), "{wrong}");
        }
    }
}
