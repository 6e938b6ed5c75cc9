#!/usr/bin/env python3
"""Prints the spectra of libbrdf/rgl_spectrum.cpp (upsampling_spectra): the smoothest non-negative curves at 16 wavelengths whose linear
sRGB under equal energy is (1, 0, 0), (0, 1, 0), (0, 0, 1), and which sum to 1. A quadratic programme, solved with an active set.

    python3 rgl_upsampling.py      (needs numpy)
"""
import numpy as np
from math import exp
def lobe(x,p,a,b):
    t=(x-p)/(a if x<p else b); return exp(-0.5*t*t)
def cmf(nm): return np.array([1.056*lobe(nm,599.8,37.9,31.0)+0.362*lobe(nm,442.0,16.0,26.7)-0.065*lobe(nm,501.1,20.4,26.2),
 0.821*lobe(nm,568.8,46.9,40.5)+0.286*lobe(nm,530.9,16.3,31.1),1.217*lobe(nm,437.0,11.8,36.0)+0.681*lobe(nm,459.0,26.0,13.8)])
S=np.array([[3.2406,-1.5372,-.4986],[-.9689,1.8758,.0415],[.0557,-.2040,1.0570]])
B=np.array([[.8951,.2664,-.1614],[-.7502,1.7135,.0367],[.0389,-.0685,1.0296]])
def weights(w):
    W=np.zeros((len(w),3)); white=np.zeros(3)
    for nm in range(360,831):
        x=cmf(nm); white+=x
        if nm<=w[0]: W[0]+=x
        elif nm>=w[-1]: W[-1]+=x
        else:
            i=np.searchsorted(w,nm,side='right'); t=(nm-w[i-1])/(w[i]-w[i-1]); W[i-1]+=(1-t)*x; W[i]+=t*x
    d65=np.linalg.inv(S)@np.ones(3)
    M=S@np.linalg.inv(B)@np.diag((B@d65)/(B@white))@B
    return W@M.T
w=np.arange(400,701,20.)
n=len(w); A=weights(w).T   # 3 x n

D=np.diff(np.eye(n),2,axis=0)
# unknown x = [B0;B1;B2] each n; constraints A Bk = e_k (9), sum_k Bk = 1 (n)
H=np.kron(np.eye(3),D.T@D)+1e-9*np.eye(3*n)
C=[];c=[]
for k in range(3):
    for r in range(3):
        row=np.zeros(3*n); row[k*n:(k+1)*n]=A[r]; C.append(row); c.append(1.0*(r==k))
for i in range(n):
    row=np.zeros(3*n); row[[i,n+i,2*n+i]]=1; C.append(row); c.append(1.0)
C=np.array(C); c=np.array(c)
active=set()
for it in range(200):
    R=[np.eye(3*n)[i] for i in sorted(active)]
    CC=np.vstack([C]+R) if R else C; cc=np.concatenate([c,np.zeros(len(R))])
    K=np.block([[H,CC.T],[CC,np.zeros((len(CC),)*2)]])
    sol=np.linalg.lstsq(K,np.concatenate([np.zeros(3*n),cc]),rcond=None)[0]; x=sol[:3*n]; lam=sol[3*n+len(C):]
    # multipliers of active bounds: H x + C^T l = 0 ; bound x>=0 needs -lam>=0
    if x.min()<-1e-10:
        active.add(int(x.argmin())); continue
    bad=[(l,i) for l,i in zip(lam,sorted(active)) if l>1e-9]
    if bad: active.remove(max(bad)[1]); continue
    break
X=x.reshape(3,n)
X=np.maximum(X,0)
for i in range(n): print("{%.9f, %.9f, %.9f}," % tuple(X[:,i]))
